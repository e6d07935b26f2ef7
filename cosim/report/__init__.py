"""What a run shows: figures, tables, a page, and estimates held against the truth."""
