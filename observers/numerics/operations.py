"""Which operations a CasADi expression is made of, and how many."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import casadi as ca

# They jump where a derivative does not show it: d fmod(x, 1) / d x = 1.
JUMPS = {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_SIGN}
# They are not defined, or infinite, for some finite arguments.
PARTIAL = {
    *(ca.OP_LOG, ca.OP_LOG1P, ca.OP_SQRT, ca.OP_DIV, ca.OP_INV, ca.OP_POW, ca.OP_CONSTPOW),
    *(ca.OP_ASIN, ca.OP_ACOS, ca.OP_ACOSH, ca.OP_ATANH, ca.OP_FMOD, ca.OP_REMAINDER),
}
STRAIGHT = 4000  # operations up to which scalars are faster than loops over short columns, and quick to compile


def straightened(function: ca.Function) -> ca.Function:
    """The function as one expression of scalars, unless that is longer than STRAIGHT; what it calls and cannot be inlined is called."""
    scalars = function.expand()
    return scalars if scalars.n_instructions() <= STRAIGHT else function


def holds(expression: ca.SX, operations: Collection[int]) -> bool:
    """Whether one of the `operations` is in the expression."""
    function = ca.Function("expression", ca.symvar(expression), [expression])
    return any(function.instruction_id(k) in operations for k in range(function.n_instructions()))


def calls(expression: ca.SX) -> Iterator[tuple[ca.Function, ca.SX]]:
    """The functions that the expression calls by themselves, such as tables, each with the node that calls it."""
    seen, todo = set(), list(ca.vertsplit(ca.vec(ca.densify(expression))))
    while todo:
        node = todo.pop()
        if node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        todo += [node.dep(i) for i in range(node.n_dep())]
        if node.op() == ca.OP_CALL:
            function = node.which_function()
            for inner in [function, *function.find_functions()]:
                yield inner, node


def is_opaque(expression: ca.SX) -> bool:
    """Whether a function is called in it whose code is elsewhere: values and first derivatives are all that there is of it."""
    return any(function.class_name() == "External" for function, _ in calls(expression))
