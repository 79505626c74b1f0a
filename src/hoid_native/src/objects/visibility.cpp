// What an image shows of the objects of the map, and which segments may show them.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "objects/objects.hpp"
#include "objects/points.hpp"

namespace hoid::objects {

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

const double* pixel_of(const double* uv_px, int64_t n)
{
  return uv_px + 2 * n;
}

// Extend a box, which has no pixels as long as it is NaN.
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
      const double *uv = pixel_of(objects.uv_px, n), u = uv[0], v = uv[1];
      ++visible;
      inside += u >= box_px[0] - 0.5 && u < box_px[2] && v >= box_px[1] - 0.5 && v < box_px[3];
    }
  }
  return static_cast<double>(inside) / static_cast<double>(std::max<int64_t>(visible, 1));
}

}  // namespace

void transform_parts(
  const double* points_m, const int64_t* ends, int num_parts, const double* T, double* out)
{
  int64_t n = 0;
  for (int part = 0; part < num_parts; ++part) {
    for (; n < ends[part]; ++n) {
      transform(T + static_cast<std::ptrdiff_t>(16) * part, point(points_m, n), out + 3 * n);
    }
  }
}

SeenVoxels seen_voxels(
  const Image<float>& depth_m, const ProjectedVoxels& voxels, const DepthMargin& margin)
{
  SeenVoxels out;
  out.uv_px.assign(static_cast<std::size_t>(2) * voxels.count, kNan);
  out.is_visible.assign(voxels.count, 0);
  std::vector<uint8_t> is_through(voxels.count, 0);
  for (int k = 0; k < voxels.num_ahead; ++k) {
    const double* uv = pixel_of(voxels.uv_px, k);
    const double u = std::nearbyint(uv[0]), v = std::nearbyint(uv[1]);
    if (!(u >= 0 && v >= 0 && u < depth_m.width && v < depth_m.height)) {
      continue;
    }
    const int64_t row = voxels.ahead[k];
    std::copy_n(uv, 2, out.uv_px.data() + 2 * row);
    const float reading = depth_m.row(static_cast<int>(v))[static_cast<int>(u)];
    const double z = voxels.depth_m[row], gap = static_cast<double>(reading) - z;
    const double most = margin.constant_m + margin.per_depth2 * z * z;
    out.is_visible[row] = reading > 0 && std::abs(gap) <= most;
    is_through[row] = reading > 0 && gap > most;
  }
  out.counts.assign(static_cast<std::size_t>(3) * voxels.num_objects, 0);
  out.boxes_px.assign(static_cast<std::size_t>(4) * voxels.num_objects, kNan);
  int64_t n = 0;
  for (int o = 0; o < voxels.num_objects; ++o) {
    int64_t* count = out.counts.data() + static_cast<std::ptrdiff_t>(3) * o;
    double* box = out.boxes_px.data() + static_cast<std::ptrdiff_t>(4) * o;
    for (; n < voxels.ends[o]; ++n) {
      if (voxels.is_solid[n]) {
        ++count[0];
        count[1] += out.is_visible[n];
        count[2] += is_through[n];
        if (out.is_visible[n]) {
          extend(box, pixel_of(out.uv_px.data(), n));
        }
      }
    }
  }
  return out;
}

std::vector<int64_t> missed_voxels(
  const double* uv_px, const uint8_t* is_visible, int count, const double* box_px,
  const int64_t* others, int num_others, int width)
{
  std::vector<int64_t> out;
  for (int n = 0; n < count; ++n) {
    if (!is_visible[n]) {
      continue;
    }
    const double *uv = pixel_of(uv_px, n), u = uv[0], v = uv[1];
    const bool is_outside = u < box_px[0] || v < box_px[1] || u > box_px[2] || v > box_px[3];
    const auto pixel = static_cast<int64_t>(std::lrint(v)) * width + std::lrint(u);
    if (is_outside || std::binary_search(others, others + num_others, pixel)) {
      out.push_back(n);
    }
  }
  return out;
}

void pair_scores(
  const SegmentSet& segments, const ObjectSet& objects, const uint8_t* is_candidate,
  double* score_out)
{
  for (int s = 0; s < segments.count; ++s) {
    const int64_t first = s == 0 ? 0 : segments.ends[s - 1];
    const auto num = static_cast<int>(segments.ends[s] - first);
    const int32_t* box_px = segments.boxes_px + static_cast<std::ptrdiff_t>(4) * s;
    for (int o = 0; o < objects.count; ++o, ++is_candidate, ++score_out) {
      *score_out = 0;
      if (!*is_candidate) {
        continue;
      }
      const int64_t first_voxel = o == 0 ? 0 : objects.ends[o - 1];
      const double seen = share_in_pixels(objects, first_voxel, objects.ends[o], box_px);
      if (seen > 0) {
        const double inside = share_in_box(
          point(segments.points_m, first), num,
          objects.T_box_map + static_cast<std::ptrdiff_t>(16) * o, point(objects.low_m, o),
          point(objects.high_m, o));
        *score_out = std::sqrt(inside * seen);
      }
    }
  }
}

}  // namespace hoid::objects
