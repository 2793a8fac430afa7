"""What firmware and other programs read: one target a file, each with a list of what it cannot carry."""
