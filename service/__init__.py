"""PhysNet's real-time service: one depth frame in, the object's full and deformed shape out."""
