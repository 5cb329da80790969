"""What can be said about a solution: accuracy, consistency. Cannot know where its data came from."""
