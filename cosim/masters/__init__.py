"""The tools that can run a system: our master, and other people's, each in a process of its own."""
