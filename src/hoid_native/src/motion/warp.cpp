#include <algorithm>
#include <cmath>
#include <cstddef>

#include "common/multiversion.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

constexpr float kNearestM = 0.1F;  // what would lie nearer to the other view is not looked up

// Where the pixels of one view lie in another, a row at a time.
class Warp
{
public:
  explicit Warp(const Views& views)
  : index(views.depth_m.width),
    there_m(views.depth_m.width),
    fx_(static_cast<float>(views.camera.fx_px)),
    fy_(static_cast<float>(views.camera.fy_px)),
    cx_(static_cast<float>(views.camera.cx_px)),
    cy_(static_cast<float>(views.camera.cy_px)),
    width_(views.depth_m.width),
    height_(views.depth_m.height),
    x_(views.depth_m.width)
  {
    std::copy_n(views.T_earlier_now, 12, T_);
    for (int u = 0; u < width_; ++u) {
      x_[u] = (static_cast<float>(u) - cx_) / fx_;
    }
  }

  // Set where each pixel of a row of depths lies.
  ALWAYS_INLINE void look_up(int v, const float* depth_m)
  {
    const float y = (static_cast<float>(v) - cy_) / fy_;
    const auto end_column = static_cast<float>(width_), end_row = static_cast<float>(height_);
    for (int u = 0; u < width_; ++u) {
      const float depth = depth_m[u], x = x_[u];
      const float z = (T_[8] * x + T_[9] * y + T_[10]) * depth + T_[11];
      const float scale = 1 / std::max(z, kNearestM);
      const float column =
        ((T_[0] * x + T_[1] * y + T_[2]) * depth + T_[3]) * scale * fx_ + cx_ + 0.5F;
      const float row =
        ((T_[4] * x + T_[5] * y + T_[6]) * depth + T_[7]) * scale * fy_ + cy_ + 0.5F;
      const bool inside = (depth > 0) & (z > kNearestM) & (column >= 0) & (row >= 0) &
                          (column < end_column) & (row < end_row);
      const int at =
        static_cast<int>(inside ? row : 0) * width_ + static_cast<int>(inside ? column : 0);
      index[u] = inside ? at : -1;
      there_m[u] = z;
    }
  }

  std::vector<int32_t> index;  // flat, in the other view; -1: out of it, or without depth
  std::vector<float> there_m;  // distance along that view's axis

private:
  float fx_, fy_, cx_, cy_, T_[12];
  int width_, height_;
  std::vector<float> x_;
};

}  // namespace

MULTIVERSION("avx2")
FrontCounts count_in_front(
  const Views& views, const int32_t* label, int num_segments, const float* nearest_m,
  const float* farthest_m, const Margin& margin)
{
  const std::vector<int32_t> none(num_segments, 0);
  FrontCounts counts{none, none, none};
  Warp warp(views);
  for (int v = 0; v < views.depth_m.height; v += 2) {
    const float* depths = views.depth_m.row(v);
    const int32_t* labels = label + static_cast<std::ptrdiff_t>(v) * views.depth_m.width;
    warp.look_up(v, depths);
    for (int u = 0; u < views.depth_m.width; ++u) {
      if (labels[u] < 0) {
        continue;
      }
      ++counts.looked_at[labels[u]];
      const int at = warp.index[u];
      if (at < 0 || !(nearest_m[at] > 0)) {
        continue;
      }
      const float margin_m = margin.at(depths[u]);
      const bool front = warp.there_m[u] < nearest_m[at] - margin_m;
      counts.in_front[labels[u]] += static_cast<int32_t>(front);
      counts.at_it[labels[u]] +=
        static_cast<int32_t>(!front && warp.there_m[u] <= farthest_m[at] + margin_m);
    }
  }
  return counts;
}

MULTIVERSION("avx2")
void carry_over(
  const Views& views, const float* before_m, const float* values, const Margin& margin,
  float* value_out)
{
  Warp warp(views);
  for (int v = 0; v < views.depth_m.height; ++v) {
    const float* depths = views.depth_m.row(v);
    warp.look_up(v, depths);
    for (int u = 0; u < views.depth_m.width; ++u) {
      const int at = warp.index[u];
      const bool same = at >= 0 && before_m[at] > 0 &&
                        std::abs(before_m[at] - warp.there_m[u]) < margin.at(depths[u]);
      *value_out++ = same ? values[at] : 0.0F;
    }
  }
}

}  // namespace hoid::motion
