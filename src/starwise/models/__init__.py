"""What a filter believes: how the user moves and how measurements come about."""
