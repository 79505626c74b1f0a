"""Recordings in folders and files of images, and their cameras; `layouts` lists them."""
