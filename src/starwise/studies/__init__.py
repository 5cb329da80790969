"""Studies: simulated and real measurements through the filters, many times, and what comes out."""
