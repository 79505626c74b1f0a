"""Detection of people and objects in color images by ONNX models (YOLO family, RT-DETR, DETR)."""
