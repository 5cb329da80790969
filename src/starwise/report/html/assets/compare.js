// Several solutions beside each other.
