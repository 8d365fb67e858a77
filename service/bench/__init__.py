"""A load generator for the service: open loop, real sockets, every latency counted from when it was due."""
