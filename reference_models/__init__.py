"""The papers' plants and experiments."""
