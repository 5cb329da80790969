"""What people read: summaries and screens. Sees solutions and truths, never a filter."""
