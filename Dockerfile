# The suite on ROS 2 Jazzy; docs/howto/another_camera.md says how to run it.
FROM ros:jazzy

WORKDIR /opt/hoid
COPY .ci/ros_packages .ci/
RUN .ci/ros_packages && rm -rf /var/lib/apt/lists/*
COPY . .
RUN . /opt/ros/jazzy/setup.sh && ./hoid setup

ENTRYPOINT ["/bin/bash", "-c", ". /opt/ros/jazzy/setup.sh && exec ./hoid \"$@\"", "hoid"]
CMD ["--help"]
