"""Views of results: pictures and pages. Nothing is computed here; every number shown is a field of a result."""
