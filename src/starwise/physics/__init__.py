"""Where satellites are and what the atmosphere does to their signals."""
