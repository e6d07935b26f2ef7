"""What can be read off an FMU's files without running anything."""
