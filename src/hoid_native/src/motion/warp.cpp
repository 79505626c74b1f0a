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
  ALWAYS_INLINE void look_up(int v, const float* __restrict depth_m)
  {
    // Copies: a loop of vectors must not fear that it writes what it reads.
    float T[12];
    std::copy_n(T_, 12, T);
    const float fx = fx_, fy = fy_, cx = cx_ + 0.5F, cy = cy_ + 0.5F;
    const float y = (static_cast<float>(v) - cy_) / fy_;
    const auto end_column = static_cast<float>(width_), end_row = static_cast<float>(height_);
    const int width = width_;
    const float* __restrict rays_x = x_.data();
    int32_t* __restrict index_out = index.data();
    float* __restrict there_out = there_m.data();
    for (int u = 0; u < width; ++u) {
      const float depth = depth_m[u], x = rays_x[u];
      const float z = (T[8] * x + T[9] * y + T[10]) * depth + T[11];
      const float scale = 1 / (z > kNearestM ? z : kNearestM);
      const float column = ((T[0] * x + T[1] * y + T[2]) * depth + T[3]) * scale * fx + cx;
      const float row = ((T[4] * x + T[5] * y + T[6]) * depth + T[7]) * scale * fy + cy;
      const bool inside = (depth > 0) & (z > kNearestM) & (column >= 0) & (row >= 0) &
                          (column < end_column) & (row < end_row);
      const int at =
        static_cast<int>(inside ? row : 0.0F) * width + static_cast<int>(inside ? column : 0.0F);
      index_out[u] = inside ? at : -1;
      there_out[u] = z;
    }
  }

  std::vector<int32_t> index;  // flat, in the other view; -1: out of it, or without depth
  std::vector<float> there_m;  // distance along that view's axis

private:
  float fx_, fy_, cx_, cy_, T_[12];
  int width_, height_;
  std::vector<float> x_;
};

// What a pixel adds to the sum of a run, which is shorter than 65536.
constexpr int32_t kFront = 1, kAtIt = 1 << 16;

// Write what each pixel of a row adds.
ALWAYS_INLINE void tell_front(
  const Warp& warp, const float* __restrict depth_m, const float* __restrict range_m,
  const Margin margin, int width, int32_t* __restrict found_out)
{
  const int32_t* __restrict index = warp.index.data();
  const float* __restrict there_m = warp.there_m.data();
  for (int u = 0; u < width; ++u) {
    const int at = index[u] < 0 ? 0 : index[u];
    const float near_m = range_m[2 * at], far_m = range_m[2 * at + 1],
                margin_m = margin.at(depth_m[u]);
    const bool known = (index[u] >= 0) & (near_m > 0);
    const bool front = there_m[u] < near_m - margin_m;
    const bool at_it = !front & (there_m[u] <= far_m + margin_m);
    const int32_t sum = (front ? kFront : 0) + (at_it ? kAtIt : 0);
    found_out[u] = known ? sum : 0;
  }
}

struct Counts
{
  std::vector<int32_t> looked_at, in_front, at_it;
};

// Add what was found at the pixels of a row to their segments, a run of equal labels at a time.
void add_runs(const int32_t* label, const int32_t* found, int width, Counts& counts)
{
  for (int first = 0, last; first < width; first = last) {
    const int32_t segment = label[first];
    int32_t sum = 0;
    for (last = first; last < width && label[last] == segment; ++last) {
      sum += found[last];
    }
    if (segment >= 0) {
      counts.looked_at[segment] += last - first;
      counts.in_front[segment] += sum % kAtIt;
      counts.at_it[segment] += sum / kAtIt;
    }
  }
}

// Write the log-odds that the pixels of a row had, faded.
ALWAYS_INLINE void carry_row(
  const Warp& warp, const float* __restrict depth_m, const float* __restrict before_m,
  const float* __restrict odds, const Margin margin, float fade, int width,
  float* __restrict odds_out)
{
  const int32_t* __restrict index = warp.index.data();
  const float* __restrict there_m = warp.there_m.data();
  for (int u = 0; u < width; ++u) {
    const int at = index[u] < 0 ? 0 : index[u];
    const float seen_m = before_m[at], carried = odds[at] * fade;
    const bool same =
      (index[u] >= 0) & (seen_m > 0) & (std::abs(seen_m - there_m[u]) < margin.at(depth_m[u]));
    odds_out[u] = same ? carried : 0.0F;
  }
}

// Add what speaks for the labels, from -1 on, of the pixels of a row.
ALWAYS_INLINE void add_row(
  const float* __restrict depth_m, const int32_t* __restrict label,
  const float* __restrict of_label, float limit, int width, float* __restrict odds)
{
  for (int u = 0; u < width; ++u) {
    const float sum = odds[u] + of_label[label[u] + 1];
    const float limited = std::max(std::min(sum, limit), -limit);
    odds[u] = depth_m[u] > 0 ? limited : 0.0F;
  }
}

}  // namespace

MULTIVERSION("avx2")
void add_front_evidence(
  const Views& views, const int32_t* label, const float* range_m, const Margin& margin,
  const FrontWorth& worth, std::vector<double>& log_odds)
{
  const std::vector<int32_t> none(log_odds.size(), 0);
  Counts counts{none, none, none};
  Warp warp(views);
  std::vector<int32_t> found(views.depth_m.width);
  for (int v = 0; v < views.depth_m.height; v += 2) {
    const float* depths = views.depth_m.row(v);
    warp.look_up(v, depths);
    tell_front(warp, depths, range_m, margin, views.depth_m.width, found.data());
    add_runs(
      label + static_cast<std::ptrdiff_t>(v) * views.depth_m.width, found.data(),
      views.depth_m.width, counts);
  }
  for (std::size_t s = 0; s < log_odds.size(); ++s) {
    const double all = std::max(counts.looked_at[s], 1);
    const double in_front = counts.in_front[s] / all, at_it = counts.at_it[s] / all;
    log_odds[s] += in_front > worth.least_front ? worth.front * in_front : 0.0;
    log_odds[s] -= in_front < worth.mixed ? worth.rest * at_it : 0.0;
  }
}

std::vector<float> depths_at(const Image<float>& depth_m, const int64_t* pixels, int count)
{
  std::vector<float> out(count);
  for (int k = 0; k < count; ++k) {
    const float depth = pixels[k] < 0 ? 0.0F : depth_m.data[pixels[k]];
    out[k] = std::isfinite(depth) ? depth : 0.0F;
  }
  return out;
}

MULTIVERSION("avx2")
void carry_over(
  const Views& views, const float* before_m, const float* odds, const Margin& margin, float fade,
  const Evidence& evidence, float* odds_out)
{
  Warp warp(views);
  const int width = views.depth_m.width;
  const int32_t* label = evidence.label;
  std::vector<float> of_label(evidence.num_segments + 1, 0.0F);
  std::copy_n(evidence.of_segment, evidence.num_segments, of_label.begin() + 1);
  for (int v = 0; v < views.depth_m.height; ++v, odds_out += width, label += width) {
    const float* depths = views.depth_m.row(v);
    warp.look_up(v, depths);
    carry_row(warp, depths, before_m, odds, margin, fade, width, odds_out);
    add_row(depths, label, of_label.data(), evidence.limit, width, odds_out);
  }
}

}  // namespace hoid::motion
