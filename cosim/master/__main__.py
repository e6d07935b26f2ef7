"""python -m cosim.master: the process of a run, for `cosim.master.watched` alone."""

from cosim.master.child import main

main()
