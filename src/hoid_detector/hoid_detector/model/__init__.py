"""ONNX models of the YOLO family: files, inputs, output layouts, decoding.

Nothing here knows ROS or topics.
"""
