"""Helpers that tests share: made inputs, simulated benches, scripted servers, independent bounds."""
