"""Thermal sessions of a device and a climatic chamber that do not exist."""
