// Registration of depth images to another camera, as depth_image_proc's `register` does.
#pragma once

#include "common/image.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

// A depth image, and its camera in the frame of the target.
struct DepthSource
{
  Image<float> depth_m;   // 0, negative or NaN = no measurement
  const float* rays;      // (H, W, 3) ray of each pixel, with length 1 along the depth camera's axis
  const float* t_m;       // (3) position of the depth camera
  const float* side_px;   // (2) width and height of a depth pixel in target pixels, at equal depth
};

// The camera to which depth is registered.
struct Target
{
  Pinhole camera;
  int width, height;
};

// Write the depth that the target camera sees at each of its pixels, and leave the other pixels,
// which must be 0. A depth pixel covers as many target pixels as it is large; the nearest depth wins.
void register_depth(const DepthSource& source, const Target& target, float* depth_out);

}  // namespace hoid::motion
