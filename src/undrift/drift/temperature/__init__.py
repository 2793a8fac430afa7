"""The temperature that tables are over: trusted, smoothed over time, the thermometer's lag found and taken off."""
