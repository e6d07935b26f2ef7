"""python -m commands: the same as the console script, where that is not on the path."""

from commands.start import main

main()
