"""Finds people and objects in colour images with any ONNX model of the YOLO family."""
