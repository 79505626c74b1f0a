"""Detection of people and objects in color images with any ONNX model of the YOLO family."""
