// Determines which voxels of known objects an image shows, and how well its segments fit these
// objects.

#include <algorithm>
#include <cmath>
#include <limits>

#include "objects/parts.hpp"

namespace hoid::objects {

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Extend a box to contain a pixel; a box of NaN is empty.
void extend(double* box_px, const double* uv)
{
  for (int axis = 0; axis < 2; ++axis) {
    box_px[axis] = std::fmin(box_px[axis], uv[axis]);
    box_px[axis + 2] = std::fmax(box_px[axis + 2], uv[axis]);
  }
}

// Return the ratio of the visible voxels of an object that are in a box; 0 if none is visible.
double share_in_pixels(const ObjectSet& objects, int64_t first, int64_t end, const int32_t* box_px)
{
  int64_t inside = 0, visible = 0;
  for (int64_t n = first; n < end; ++n) {
    if (objects.is_visible[n]) {
      const double u = objects.uv_px[n][0], v = objects.uv_px[n][1];
      ++visible;
      inside += u >= box_px[0] - 0.5 && u < box_px[2] && v >= box_px[1] - 0.5 && v < box_px[3];
    }
  }
  return static_cast<double>(inside) / static_cast<double>(std::max<int64_t>(visible, 1));
}

}  // namespace

void transform_parts(
  const Points& points_m, const Rows<int64_t>& ends, const Transforms& T, double* out)
{
  int64_t n = 0;
  for (int part = 0; part < ends.count; ++part) {
    for (; n < ends[part]; ++n) {
      transform(T[part], points_m[n], out + 3 * n);
    }
  }
}

SeenVoxels seen_voxels(
  const Image<float>& depth_m, const ProjectedVoxels& voxels, const DepthMargin& margin)
{
  const auto count = static_cast<std::size_t>(voxels.depth_m.count);
  const auto num_objects = static_cast<std::size_t>(voxels.ends.count);
  SeenVoxels out{
    std::vector<double>(2 * count, kNan), std::vector<uint8_t>(count),
    std::vector<int64_t>(3 * num_objects), std::vector<double>(4 * num_objects, kNan)};
  std::vector<uint8_t> is_through(count, 0);
  for (int k = 0; k < voxels.ahead.count; ++k) {
    const double* uv = voxels.uv_px[k];
    const double u = std::nearbyint(uv[0]), v = std::nearbyint(uv[1]);
    if (!(u >= 0 && v >= 0 && u < depth_m.width && v < depth_m.height)) {
      continue;
    }
    const int64_t row = voxels.ahead[k];
    std::copy_n(uv, 2, &out.uv_px[2 * row]);
    const float reading = depth_m.row(static_cast<int>(v))[static_cast<int>(u)];
    const double z = voxels.depth_m[row], gap = static_cast<double>(reading) - z;
    const double most = margin.constant_m + margin.per_depth2 * z * z;
    out.is_visible[row] = reading > 0 && std::abs(gap) <= most;
    is_through[row] = reading > 0 && gap > most;
  }
  int64_t n = 0;
  for (std::size_t o = 0; o < num_objects; ++o) {
    int64_t* counts = &out.counts[3 * o];
    for (; n < voxels.ends[o]; ++n) {
      if (voxels.is_solid[n]) {
        ++counts[0];
        counts[1] += out.is_visible[n];
        counts[2] += is_through[n];
        if (out.is_visible[n]) {
          extend(&out.boxes_px[4 * o], &out.uv_px[2 * n]);
        }
      }
    }
  }
  return out;
}

std::vector<int64_t> missed_voxels(
  const Rows<double, 2>& uv_px, const uint8_t* is_visible, const double* box_px,
  const Rows<int64_t>& others, int width)
{
  std::vector<int64_t> out;
  for (int n = 0; n < uv_px.count; ++n) {
    if (!is_visible[n]) {
      continue;
    }
    const double u = uv_px[n][0], v = uv_px[n][1];
    const bool is_outside = u < box_px[0] || v < box_px[1] || u > box_px[2] || v > box_px[3];
    const auto pixel = static_cast<int64_t>(std::lrint(v)) * width + std::lrint(u);
    if (is_outside || std::binary_search(others.begin(), others.end(), pixel)) {
      out.push_back(n);
    }
  }
  return out;
}

void pair_scores(
  const SegmentSet& segments, const ObjectSet& objects, const uint8_t* is_candidate,
  double* score_out)
{
  for (int s = 0; s < segments.ends.count; ++s) {
    const int64_t first = s == 0 ? 0 : segments.ends[s - 1];
    const Points points_m{
      segments.points_m[first], static_cast<int>(segments.ends[s] - first)};
    for (int o = 0; o < objects.ends.count; ++o, ++is_candidate, ++score_out) {
      *score_out = 0;
      if (!*is_candidate) {
        continue;
      }
      const int64_t first_voxel = o == 0 ? 0 : objects.ends[o - 1];
      const double seen =
        share_in_pixels(objects, first_voxel, objects.ends[o], segments.boxes_px[s]);
      if (seen > 0) {
        const double inside = share_of(points_m, [&](const double* p) {
          return is_in_box(objects.T_box_map[o], objects.low_m[o], objects.high_m[o], p);
        });
        *score_out = std::sqrt(inside * seen);
      }
    }
  }
}

}  // namespace hoid::objects
