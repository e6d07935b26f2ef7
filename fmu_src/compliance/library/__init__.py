"""What an FMU's library does when it is driven, each probe in a process of its own."""
