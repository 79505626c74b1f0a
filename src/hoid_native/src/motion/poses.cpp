#include <algorithm>
#include <cmath>
#include <cstddef>

#include "common/multiversion.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

constexpr double kNearestM = 0.1;  // a point nearer to the camera fits no pose

}  // namespace

MULTIVERSION("avx2")
void score_poses(
  const optimize::StereoParams& camera, double pixel_px, double limit,
  const double* T_camera_world, int num_poses, const Points& points, double* score_out)
{
  const double per_limit2 = 1 / (pixel_px * pixel_px * limit * limit);
  const double per_disparity2 = 1 / (camera.disparity_noise_px * camera.disparity_noise_px);
  for (int m = 0; m < num_poses; ++m) {
    const double* T = T_camera_world + static_cast<std::ptrdiff_t>(16) * m;
    double score[2] = {0, 0};
    for (int k = 0; k < points.count; ++k) {
      const double *X = points.points_m + static_cast<std::ptrdiff_t>(3) * k,
                   *seen = points.measured_px + static_cast<std::ptrdiff_t>(3) * k;
      const double z = T[8] * X[0] + T[9] * X[1] + T[10] * X[2] + T[11];
      const double scale = 1 / std::max(z, kNearestM);
      const double u = (T[0] * X[0] + T[1] * X[1] + T[2] * X[2] + T[3]) * scale * camera.fx_px +
                       camera.cx_px - seen[0];
      const double v = (T[4] * X[0] + T[5] * X[1] + T[6] * X[2] + T[7]) * scale * camera.fy_px +
                       camera.cy_px - seen[1];
      const double d =
        std::isnan(seen[2]) ? 0.0 : camera.disparity_px_m * scale - (seen[0] - seen[2]);
      const double share = 1 - (u * u + v * v + d * d * per_disparity2) * per_limit2;
      const double counted = z > kNearestM ? std::max(0.0, share) : 0.0;
      score[0] += counted * points.weights[2 * k];
      score[1] += counted * points.weights[2 * k + 1];
    }
    score_out[2 * m] = score[0];
    score_out[2 * m + 1] = score[1];
  }
}

}  // namespace hoid::motion
