"""Detection of people and objects in color images with ONNX models of the YOLO family, RT-DETR or DETR."""
