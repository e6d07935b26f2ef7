"""observer-fmus: the one way in. Each verb is a file of its own beside this one, loaded only when it is wanted: some take seconds."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from observers import __version__

NAME = "observer-fmus"
VERBS = ("build", "run", "compare", "campaign", "replay", "check")


class _Verbs(TyperGroup):
    """The verb NAME is the function NAME of commands/NAME.py. (Typer brings a click of its own or not, by version: hence Any.)"""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in VERBS:
            return None
        alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        alone.command(cmd_name)(getattr(import_module(f"commands.{cmd_name}"), cmd_name))
        return typer.main.get_command(alone)


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
    """Nonlinear state observers as FMI 2.0 co-simulation FMUs: build, couple, vary, replay and check them."""


def main() -> None:
    """The console script `observer-fmus`."""
    app(prog_name=NAME)
