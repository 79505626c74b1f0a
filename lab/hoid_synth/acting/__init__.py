"""Who goes where and handles what, and the path of the camera.

Nothing here renders.
"""
