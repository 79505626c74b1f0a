#include "graph/moved_points.hpp"

namespace hoid::graph {

void move_points(
  const double* motions, const int64_t* which, int count, double* position_m,
  float* view_direction)
{
  for (int n = 0; n < count; ++n) {
    if (which[n] < 0) {
      continue;
    }
    const double* T = motions + 16 * which[n];
    double* p = position_m + 3 * static_cast<int64_t>(n);
    float* v = view_direction + 3 * static_cast<int64_t>(n);
    double moved[3], turned[3];
    for (int row = 0; row < 3; ++row) {
      const double* R = T + 4 * row;
      moved[row] = R[0] * p[0] + R[1] * p[1] + R[2] * p[2] + R[3];
      turned[row] = R[0] * v[0] + R[1] * v[1] + R[2] * v[2];
    }
    for (int row = 0; row < 3; ++row) {
      p[row] = moved[row];
      v[row] = static_cast<float>(turned[row]);
    }
  }
}

}  // namespace hoid::graph
