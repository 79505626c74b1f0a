# The suite on ROS 2 Jazzy; docs/howto/another_camera.md says how to run it.
FROM ros:jazzy

RUN apt-get update && apt-get install -y --no-install-recommends \
    git python3-venv python3-dev build-essential cmake python3-opencv \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/hoid
COPY . .
RUN . /opt/ros/jazzy/setup.sh && ./hoid setup

ENTRYPOINT ["/bin/bash", "-c", ". /opt/ros/jazzy/setup.sh && exec ./hoid \"$@\"", "hoid"]
CMD ["--help"]
