"""Least squares and Kalman filters, and whole runs with them."""
