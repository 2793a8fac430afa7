"""Galil motion controllers, by their two-letter ASCII language."""
