#include <algorithm>
#include <cmath>

#include "common/multiversion.hpp"
#include "motion/motion.hpp"

namespace hoid::motion {

namespace {

constexpr float kMinDepthM = 0.1F;  // chosen: nearer than most depth cameras measure

// Reprojects the pixels of the current view into the earlier one, a row at a time.
class Reprojection
{
public:
  explicit Reprojection(const ViewPair& views)
  : index(views.depth_m.width), depth_there_m(index.size()), views_(views), rays_x_(index.size())
  {
    const auto fx = static_cast<float>(views.camera.fx_px),
               cx = static_cast<float>(views.camera.cx_px);
    for (int u = 0; u < views.depth_m.width; ++u) {
      rays_x_[u] = (static_cast<float>(u) - cx) / fx;
    }
  }

  // Set `index` and `depth_there_m` of row v.
  ALWAYS_INLINE void reproject_row(int v, const float* __restrict depth_m)
  {
    // Copies: they show the compiler that the loop's outputs cannot alias its inputs.
    float T[12];
    std::copy_n(views_.T_earlier_now, 12, T);
    const int width = views_.depth_m.width;
    const auto end_column = static_cast<float>(width),
               end_row = static_cast<float>(views_.depth_m.height);
    const auto fx = static_cast<float>(views_.camera.fx_px),
               fy = static_cast<float>(views_.camera.fy_px),
               row_of_center = static_cast<float>(views_.camera.cy_px);
    const float y = (static_cast<float>(v) - row_of_center) / fy;
    const float cx = static_cast<float>(views_.camera.cx_px) + 0.5F, cy = row_of_center + 0.5F;
    const float* __restrict rays_x = rays_x_.data();
    int32_t* __restrict index_out = index.data();
    float* __restrict depth_out = depth_there_m.data();
    for (int u = 0; u < width; ++u) {
      const float depth = depth_m[u], x = rays_x[u];
      const float z = (T[8] * x + T[9] * y + T[10]) * depth + T[11];
      const float scale = 1 / (z > kMinDepthM ? z : kMinDepthM);
      const float column = ((T[0] * x + T[1] * y + T[2]) * depth + T[3]) * scale * fx + cx;
      const float row = ((T[4] * x + T[5] * y + T[6]) * depth + T[7]) * scale * fy + cy;
      const bool inside = (depth > 0) & (z > kMinDepthM) & (column >= 0) & (row >= 0) &
                          (column < end_column) & (row < end_row);
      const int at =
        static_cast<int>(inside ? row : 0.0F) * width + static_cast<int>(inside ? column : 0.0F);
      index_out[u] = inside ? at : -1;
      depth_out[u] = z;
    }
  }

  std::vector<int32_t> index;  // flat, in the earlier view; -1: outside, or without depth
  std::vector<float> depth_there_m;  // depth of the point in the earlier view

private:
  const ViewPair& views_;
  std::vector<float> rays_x_;
};

// Two counters in one number, which is faster; runs are shorter than 65536 pixels.
constexpr int32_t kOccluding = 1, kAgreeing = 1 << 16;

// Write whether each pixel of a row occludes the earlier depth or agrees with it.
ALWAYS_INLINE void compare_row(
  const Reprojection& reprojection, const float* __restrict depth_m,
  const float* __restrict range_m, const DepthMargin margin, int width,
  int32_t* __restrict found_out)
{
  const int32_t* __restrict index = reprojection.index.data();
  const float* __restrict depth_there_m = reprojection.depth_there_m.data();
  for (int u = 0; u < width; ++u) {
    const int at = index[u] < 0 ? 0 : index[u];
    const float near_m = range_m[2 * at], far_m = range_m[2 * at + 1],
                margin_m = margin.at(depth_m[u]);
    const bool is_known = (index[u] >= 0) & (near_m > 0);
    const bool occludes = depth_there_m[u] < near_m - margin_m;
    const bool agrees = !occludes & (depth_there_m[u] <= far_m + margin_m);
    const int32_t sum = (occludes ? kOccluding : 0) + (agrees ? kAgreeing : 0);
    found_out[u] = is_known ? sum : 0;
  }
}

struct Counts
{
  std::vector<int32_t> compared, occluding, agreeing;  // pixels of each segment
};

// Add a row's comparisons to the counts of its segments, one run of equal labels at a time.
void add_runs(const int32_t* label, const int32_t* found, int width, Counts& counts)
{
  for (int first = 0, last; first < width; first = last) {
    const int32_t segment = label[first];
    int32_t sum = 0;
    for (last = first; last < width && label[last] == segment; ++last) {
      sum += found[last];
    }
    if (segment >= 0) {
      counts.compared[segment] += last - first;
      counts.occluding[segment] += sum % kAgreeing;
      counts.agreeing[segment] += sum / kAgreeing;
    }
  }
}

// Write the decayed log-odds that a row's pixels had in the previous image; 0 if it showed another
// depth.
ALWAYS_INLINE void propagate_row(
  const Reprojection& reprojection, const float* __restrict depth_m,
  const float* __restrict previous_m, const float* __restrict log_odds, const DepthMargin margin,
  float decay, int width, float* __restrict log_odds_out)
{
  const int32_t* __restrict index = reprojection.index.data();
  const float* __restrict depth_there_m = reprojection.depth_there_m.data();
  for (int u = 0; u < width; ++u) {
    const int at = index[u] < 0 ? 0 : index[u];
    const float previous = previous_m[at], decayed = log_odds[at] * decay;
    const bool same = (index[u] >= 0) & (previous > 0) &
                      (std::abs(previous - depth_there_m[u]) < margin.at(depth_m[u]));
    log_odds_out[u] = same ? decayed : 0.0F;
  }
}

// Add the log-odds of labels -1, 0, 1 ... to a row's pixels, and clamp the sums.
ALWAYS_INLINE void add_evidence_row(
  const float* __restrict depth_m, const int32_t* __restrict label,
  const float* __restrict of_label, float limit, int width, float* __restrict log_odds)
{
  for (int u = 0; u < width; ++u) {
    const float sum = log_odds[u] + of_label[label[u] + 1];
    const float limited = std::max(std::min(sum, limit), -limit);
    log_odds[u] = depth_m[u] > 0 ? limited : 0.0F;
  }
}

}  // namespace

MULTIVERSION("avx2")
void add_occlusion_evidence(
  const ViewPair& views, const Image<int32_t>& label, const float* range_m,
  const DepthMargin& margin, const OcclusionEvidence& evidence, std::vector<double>& log_odds)
{
  const std::vector<int32_t> none(log_odds.size(), 0);
  Counts counts{none, none, none};
  Reprojection reprojection(views);
  std::vector<int32_t> found(views.depth_m.width);
  for (int v = 0; v < views.depth_m.height; v += 2) {
    const float* depths = views.depth_m.row(v);
    reprojection.reproject_row(v, depths);
    compare_row(reprojection, depths, range_m, margin, views.depth_m.width, found.data());
    add_runs(label.row(v), found.data(), views.depth_m.width, counts);
  }
  for (std::size_t s = 0; s < log_odds.size(); ++s) {
    const double all = std::max(counts.compared[s], 1);
    const double occluding = counts.occluding[s] / all, agreeing = counts.agreeing[s] / all;
    log_odds[s] += occluding > evidence.min_occluding_share ? evidence.occluding * occluding : 0.0;
    log_odds[s] -= occluding < evidence.mixed_share ? evidence.agreeing * agreeing : 0.0;
  }
}

MULTIVERSION("avx2")
void propagate_log_odds(
  const ViewPair& views, const float* previous_m, const float* log_odds, const DepthMargin& margin,
  float decay, const SegmentEvidence& evidence, float* log_odds_out)
{
  Reprojection reprojection(views);
  const int width = views.depth_m.width;
  std::vector<float> of_label(1, 0.0F);  // label -1 first
  of_label.insert(of_label.end(), evidence.log_odds.begin(), evidence.log_odds.end());
  for (int v = 0; v < views.depth_m.height; ++v, log_odds_out += width) {
    const float* depths = views.depth_m.row(v);
    reprojection.reproject_row(v, depths);
    propagate_row(
      reprojection, depths, previous_m, log_odds, margin, decay, width, log_odds_out);
    add_evidence_row(
      depths, evidence.label.row(v), of_label.data(), evidence.limit, width, log_odds_out);
  }
}

}  // namespace hoid::motion
