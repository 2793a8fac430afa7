"""sim.device"""
