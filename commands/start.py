"""Where the command begins: nothing that takes a moment has been imported yet, so that Ctrl-C is heard from then on."""

from commands import loading


def main() -> None:
    """The console script `observer-fmus`."""
    loading.begins()
    from commands.app import main as begin

    begin()
