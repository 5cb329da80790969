"""Files in, nouns out, and back: RINEX, SP3, CLK, positions and results."""
