# The suite on ROS 2 Jazzy: `docker build -t hoid .`, then `docker run --network host --ipc host hoid nodes --camera realsense`.
FROM ros:jazzy

RUN apt-get update && apt-get install -y --no-install-recommends \
    git python3-venv python3-dev build-essential cmake \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/hoid
COPY . .
RUN . /opt/ros/jazzy/setup.sh && ./hoid setup

ENTRYPOINT ["/bin/bash", "-c", ". /opt/ros/jazzy/setup.sh && exec ./hoid \"$@\"", "hoid"]
CMD ["--help"]
