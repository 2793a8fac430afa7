"""Rigs: what turns a device through known angles at known rates, and the programme that it is driven by."""
