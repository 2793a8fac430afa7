"""Pictures and pages of results. Nothing is computed here. Every number is a field of a result."""
