// Rigid motion of map points together with their keyframes.
#pragma once

#include <cstdint>

namespace hoid::graph {

// Move points in place, each by the motion with its number; a negative number leaves it.
void move_points(
  const double* motions,  // (G, 4, 4)
  const int64_t* which,   // (N,)
  int count,
  double* position_m,      // (N, 3)
  float* view_direction);  // (N, 3)

}  // namespace hoid::graph
