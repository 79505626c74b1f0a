"""ONNX detection models: files, inputs, output layouts and decoders. No ROS here."""

import os

# Set before onnxruntime is imported: from 1.29 on, onnxruntime sends names and hashes of models to
# its vendor.
os.environ.setdefault('ORT_DISABLE_TELEMETRY', '1')
