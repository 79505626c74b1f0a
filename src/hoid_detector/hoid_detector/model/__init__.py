"""ONNX detection models: files, inputs, output layouts and decoders. No ROS here."""

import os

# Must be set before onnxruntime is imported: from 1.29 on it reports names and hashes of models
# to its maker.
os.environ.setdefault('ORT_DISABLE_TELEMETRY', '1')
