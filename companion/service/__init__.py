"""The live service: wiring, loop, health, publishing."""
