"""ONNX models of the YOLO family: files, inputs, output layouts, decoding.

Nothing here knows ROS or topics.
"""

import os

# Before onnxruntime is imported: from 1.29 on it reports models, by name and hash, to its maker.
os.environ.setdefault('ORT_DISABLE_TELEMETRY', '1')
