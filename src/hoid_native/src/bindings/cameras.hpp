// Cameras as arguments.
#pragma once

#include "bindings/arrays.hpp"
#include "motion/motion.hpp"
#include "optimize/optimize.hpp"

namespace hoid::bindings {

HOID_PARAMETERS(motion::Pinhole, "Pinhole", double, double, double, double);
HOID_PARAMETERS(
  optimize::StereoParams, "StereoParams", double, double, double, double, double, double, double,
  double, bool);

}  // namespace hoid::bindings
