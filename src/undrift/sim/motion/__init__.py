"""sim.motion"""
