"""sim: a device and a bench that do not exist, with forward equations of their own."""
