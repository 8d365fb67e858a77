"""ONNX Runtime sessions and a NumPy façade for each of the two networks."""
