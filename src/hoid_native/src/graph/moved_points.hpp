// Moves map points rigidly together with their keyframes.
#pragma once

#include <cstdint>

namespace hoid::graph {

// Transform N points and their viewing directions in place, each by one of G rigid motions.
void move_points(
  const double* motions,  // (G, 4, 4)
  const int64_t* which,   // (N,) index of the motion of each point; negative: it does not move
  int count,
  double* position_m,      // (N, 3)
  float* view_direction);  // (N, 3) unit vectors

}  // namespace hoid::graph
