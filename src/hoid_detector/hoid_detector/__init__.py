"""Detection of people and objects in color images: YOLO family, RT-DETR or DETR as ONNX."""
