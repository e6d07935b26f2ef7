"""The faults that are tried on Python: found in its syntax tree, made in its text, so that everything else stays as it is."""

from __future__ import annotations

import ast
from collections.abc import Iterator

Mutation = tuple[str, int, int, str]  # (operator, start, end, new text)

BINARY = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*", ast.FloorDiv: "*", ast.Mod: "*"}
COMPARED = {
    ast.Lt: ("<=", ">="),
    ast.LtE: ("<", ">"),
    ast.Gt: (">=", "<="),
    ast.GtE: (">", "<"),
    ast.Eq: ("!=",),
    ast.NotEq: ("==",),
    ast.In: ("not in",),
    ast.NotIn: ("in",),
    ast.Is: ("is not",),
    ast.IsNot: ("is",),
}
SWAPPED = {
    "min": "max",
    "fmin": "fmax",
    "minimum": "maximum",
    "any": "all",
    "logic_and": "logic_or",
    "floor": "ceil",
    "sin": "cos",
    "sum1": "mmax",
    "argmin": "argmax",
    "isnan": "isinf",
}
SWAPPED |= {new: old for old, new in SWAPPED.items() if new != "mmax"}
SILENT = ("__str__", "__repr__")  # words for people
FIELD = ("default", "default_factory")  # options of a dataclass field that say more than how it is shown and compared
BORDER = "HUGE"  # whether a number that large counts as finite is all the same


class _Text:
    """Positions of the syntax tree as positions in the text."""

    def __init__(self, text: str):
        self.text = text
        self.lines = text.splitlines(keepends=True)
        self.offsets = [0]
        for line in self.lines:
            self.offsets.append(self.offsets[-1] + len(line))

    def at(self, line: int, column: int) -> int:
        return self.offsets[line - 1] + len(self.lines[line - 1].encode()[:column].decode())

    def span(self, node: ast.AST) -> tuple[int, int]:
        return self.at(node.lineno, node.col_offset), self.at(node.end_lineno, node.end_col_offset)

    def of(self, node: ast.AST) -> str:
        start, end = self.span(node)
        return self.text[start:end]

    def between(self, left: ast.AST, right: ast.AST, symbol: str) -> tuple[int, int]:
        """Where the operator `symbol` stands between two operands, brackets and comments apart."""
        start, end = self.span(left)[1], self.span(right)[0]
        found = self.text.index(symbol, start, end)
        return found, found + len(symbol)


def mutations(text: str) -> list[Mutation]:
    """Every fault that the operators know in `text`."""
    source, tree = _Text(text), ast.parse(text)
    return list(dict.fromkeys(_visit(source, tree, set())))


def _visit(source: _Text, node: ast.AST, assigned: set[str]) -> Iterator[Mutation]:
    if isinstance(node, ast.FunctionDef):
        if node.name in SILENT:
            return
        assigned = set()
    yield from _faults(source, node, assigned)
    if isinstance(node, ast.Dict) and [key.value for key in node.keys if isinstance(key, ast.Constant)] == ["cse"]:
        return  # the same numbers from longer code
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list") or isinstance(node, ast.JoinedStr | ast.Assert):
            continue
        if name == "keywords":
            value = [option for option in value if not _changes_nothing(node, option)]
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _visit(source, child, assigned)
    if isinstance(node, ast.Assign | ast.AugAssign | ast.For):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        assigned.update(n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name))


def _faults(source: _Text, node: ast.AST, assigned: set[str]) -> Iterator[Mutation]:
    match node:
        case ast.BinOp() if type(node.op) in BINARY and not _is_text(node.left) and not _is_text(node.right):
            symbol = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
            symbol |= {ast.FloorDiv: "//", ast.Mod: "%"}
            start, end = source.between(node.left, node.right, symbol[type(node.op)])
            yield "arithmetic", start, end, BINARY[type(node.op)]
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            start, end = source.span(node)
            yield "sign" if isinstance(node.op, ast.USub) else "condition", start, end, source.of(node.operand)
        case ast.Compare():
            yield from _comparisons(source, node)
        case ast.BoolOp():
            word, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield "and/or", *source.between(left, right, word), other
        case ast.If() | ast.IfExp() | ast.While():
            yield "condition", *source.span(node.test), f"(not ({source.of(node.test)}))"
        case ast.Call():
            name = node.func
            word = name.attr if isinstance(name, ast.Attribute) else name.id if isinstance(name, ast.Name) else ""
            if word in SWAPPED:
                end = source.span(name)[1]
                yield "swapped function", end - len(word), end, SWAPPED[word]
        case ast.Constant(value=bool()):
            yield "constant", *source.span(node), str(not node.value)
        case ast.Constant(value=int()):
            yield "constant", *source.span(node), str(node.value + 1)
        case ast.Constant(value=float()):
            yield "constant", *source.span(node), repr(node.value * 2 if node.value else 1.0)
        case ast.Raise():
            yield "dropped statement", *source.span(node), "pass"
        case ast.Expr(value=ast.Call()) | ast.AugAssign():
            yield "dropped statement", *source.span(node), "pass"
        case ast.Assign(targets=[target]) if _is_known(target, assigned):
            yield "dropped statement", *source.span(node), "pass"


def _comparisons(source: _Text, node: ast.Compare) -> Iterator[Mutation]:
    operands = [node.left, *node.comparators]
    symbols = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
    words = {ast.In: "in", ast.NotIn: "not in", ast.Is: "is", ast.IsNot: "is not"}
    for left, op, right in zip(operands, node.ops, operands[1:], strict=False):
        start, end = source.between(left, right, (symbols | words)[type(op)])
        news = COMPARED[type(op)]
        for new in news[1:] if isinstance(right, ast.Name) and right.id == BORDER else news:
            yield "comparison", start, end, new


def _changes_nothing(call: ast.AST, option: ast.AST) -> bool:
    """Whether sound code runs the same whatever the option says: lengths that agree are not checked, a field is shown or not."""
    match call, option:
        case ast.Call(func=ast.Name(id="zip")), ast.keyword(arg="strict"):
            return True
        case ast.Call(func=ast.Name(id="field")), ast.keyword(arg=name):
            return name not in FIELD
    return False


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _is_known(target: ast.AST, assigned: set[str]) -> bool:
    """Whether what is assigned had a value before, which stays if the assignment is dropped."""
    return isinstance(target, ast.Attribute | ast.Subscript) or (isinstance(target, ast.Name) and target.id in assigned)
