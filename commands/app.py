"""observer-fmus: the one way in. Each verb is a file of its own beside this one, loaded only when it is wanted: some take seconds."""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from commands import loading
from commands.console import NAME, say
from observers import __version__

VERBS = (
    "new",
    "gallery",
    "advise",
    "build",
    "signal",
    "describe",
    "wrap",
    "system",
    "run",
    "compare",
    "campaign",
    "replay",
    "tune",
    "check",
)


class _Verbs(TyperGroup):
    """The verb NAME is the function NAME of commands/NAME.py. (Typer brings a click of its own or not, by version: hence Any.)"""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(VERBS)

    def main(self, *args: Any, **options: Any) -> Any:
        """As typer's own, but whatever a user gets wrong ends with one line: a wrong word, option or value, a file out of reach."""
        if not options.setdefault("standalone_mode", True):
            return super().main(*args, **options)
        try:
            code = super().main(*args, **(options | {"standalone_mode": False}))
        except OSError as error:  # what no verb foresaw; where it did, it says what it was doing
            say(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            code = 2
        except Exception as error:
            if not hasattr(error, "format_message"):  # click's, typer's: whichever this version of typer brings
                raise
            if error.format_message():  # empty: no word at all was given, and the help has been shown
                say(_sentence(error))
            code = 2
        sys.exit(code if isinstance(code, int) else 0)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """What the list of all verbs shows of one; `resolve_command` loads the one that is called."""
        if cmd_name not in VERBS:
            return None
        return TyperCommand(cmd_name, help=_description(cmd_name))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        return name, _loaded(name) if name in VERBS else command, rest


def _description(verb: str) -> str:
    """The docstring of a verb, read from its file: importing all of them would take seconds."""
    module = ast.parse(Path(__file__).with_name(f"{verb}.py").read_text(encoding="utf-8"))
    functions = (node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == verb)
    return ast.get_docstring(next(functions)) or ""


def _loaded(verb: str) -> Any:
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    alone.command(verb)(getattr(import_module(f"commands.{verb}"), verb))
    loading.is_done()
    return typer.main.get_command(alone)


def _sentence(error: Any) -> str:
    """What typer says of a wrong command line, and whose help tells what is right."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else NAME
    return f"{error.format_message().rstrip('.')}; see {path} --help"


app = typer.Typer(name=NAME, cls=_Verbs, no_args_is_help=True, pretty_exceptions_enable=False)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"{NAME} {__version__}")
        raise typer.Exit()


@app.callback()
def observer_fmus(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Nonlinear state observers as FMI 2.0 co-simulation FMUs: choose, build, couple, vary, replay and check them."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script `observer-fmus`; `arguments` instead of the process's."""
    app(arguments, prog_name=NAME)
