#include "masks/masks.hpp"

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

std::array<std::size_t, 2> shape_of(const auto& image)
{
  return {image.array.shape(0), image.array.shape(1)};
}

auto sample_depths_m(const ImageArray<float>& depth_m, const BoxArray& boxes, int side_px)
{
  require_pixels("depth_m", depth_m);
  require_finite("boxes_xyxy_px", boxes);
  require(side_px >= 1, "side_px: must be at least 1");
  std::vector<double> median_m(boxes.size());
  unlocked([&] { masks::sample_depths(view(depth_m), view(boxes), side_px, median_m.data()); });
  return give(std::move(median_m));
}

auto depths_off_edges_m(
  const ImageArray<float>& depth_m, const Array<int32_t, -1, 2>& pixels_xy, int radius_px,
  double step)
{
  const int width = depth_m.size(1), height = depth_m.size(0);
  bool inside = true;
  for (int n = 0; n < pixels_xy.size(); ++n) {
    const int x = pixels_xy.data()[2 * n], y = pixels_xy.data()[2 * n + 1];
    inside &= (x >= 0) & (x < width) & (y >= 0) & (y < height);
  }
  if (!inside) {
    refuse(
      "pixels must be inside the image of " + std::to_string(width) + " x " +
      std::to_string(height) + " px");
  }
  const int radius = std::clamp(radius_px, 0, std::max(width, height));
  std::vector<float> reading_m(pixels_xy.size());
  unlocked([&] {
    masks::depths_off_edges(
      view(depth_m), pixels_xy.data(), pixels_xy.size(), radius, step, reading_m.data());
  });
  return give(std::move(reading_m));
}

auto torso_depths_m(
  const ImageArray<float>& depth_m, const BoxArray& boxes, const RealArray<-1>& known_m)
{
  require_finite("boxes_xyxy_px", boxes);
  require_length("known_m", known_m, boxes.size());
  std::vector<double> torso_m(boxes.size());
  unlocked(
    [&] { masks::torso_depths(view(depth_m), view(boxes), known_m.data(), torso_m.data()); });
  return give(std::move(torso_m));
}

void require_areas(const Array<int32_t, -1, 4>& areas, int width, int height)
{
  for (int n = 0; n < areas.size(); ++n) {
    const int32_t* area = areas.data() + 4 * static_cast<std::ptrdiff_t>(n);
    const bool inside = std::min({area[0], area[1], area[2], area[3]}) >= 0 &&
                        std::max(area[0], area[2]) <= width &&
                        std::max(area[1], area[3]) <= height;
    if (!inside) {
      refuse(
        "areas must be inside the image of " + std::to_string(width) + " x " +
        std::to_string(height) + " px");
    }
  }
}

auto cover_things(
  const ImageArray<float>& depth_m, const Array<int32_t, -1, 4>& areas,
  const RealArray<-1>& depths_m, const RealArray<-1>& reaches_m,
  const Vector<uint8_t>& certainties, const Vector<bool>& seen)
{
  const int count = areas.size();
  require_areas(areas, depth_m.size(1), depth_m.size(0));
  require_length("depths_m", depths_m, count);
  require_length("reaches_m", reaches_m, count);
  require_length("certainties", certainties, count);
  require_length("seen", seen, count);
  const masks::Things things{
    areas.data(),
    depths_m.data(),
    reaches_m.data(),
    certainties.data(),
    reinterpret_cast<const uint8_t*>(seen.data()),
    count};
  std::vector<uint8_t> certainty(depth_m.array.size());
  unlocked([&] { masks::cover_things(view(depth_m), things, certainty.data()); });
  return give(std::move(certainty), shape_of(depth_m));
}

auto widen(const ImageArray<uint8_t>& mask, int reach_px)
{
  const int reach = std::clamp(reach_px, 0, std::max(mask.size(0), mask.size(1)));
  std::vector<uint8_t> wide(mask.array.size());
  unlocked([&] { masks::widen(view(mask), reach, wide.data()); });
  return give(std::move(wide), shape_of(mask));
}

auto values_at(
  const Vector<int64_t>& pixels, const ImageArray<uint8_t>& values, const Vector<int64_t>& rows,
  const Vector<int64_t>& columns)
{
  require_range("rows", rows, 0, values.size(0));
  require_range("columns", columns, 0, values.size(1));
  require_range("pixels", pixels, 0, static_cast<int64_t>(rows.size()) * columns.size());
  std::vector<uint8_t> value(pixels.size());
  const masks::Magnification magnification{rows.data(), columns.data(), columns.size()};
  unlocked([&] {
    masks::values_at(view(values), magnification, pixels.data(), pixels.size(), value.data());
  });
  return give(std::move(value));
}

void bind_depths(nb::module_& module)
{
  module.def("sample_depths_m", &sample_depths_m, "depth_m"_a, "boxes_xyxy_px"_a, "side_px"_a, R"(
Return the (N,) median readings of squares at the centres of boxes; NaN without any.

Args:
    depth_m: (H, W) float32, not empty; 0 or NaN = no reading.
    boxes_xyxy_px: (N, 4), finite.
    side_px: side of a square, at least 1; beyond the image it sees the image's edge.

Raises:
    ValueError: The image is empty, a box is not finite, or the side is less than 1.)");
  module.def(
    "depths_off_edges_m", &depths_off_edges_m, "depth_m"_a, "pixels_xy"_a, "radius_px"_a, "step"_a,
    R"(
Return the (N,) readings at pixels; 0 where there is none, or where an edge is near.

Beside an edge a depth camera may read the surface on the other side of it.

Args:
    depth_m: (H, W) float32; 0 or NaN = no reading.
    pixels_xy: (N, 2) int32 x, y.
    radius_px: half the side of the square around a pixel in which no edge may be; 0: any may.
    step: share of the reading by which others in the square differ where there is one.

Raises:
    ValueError: A pixel is not in the image.)");
  module.def("torso_depths_m", &torso_depths_m, "depth_m"_a, "boxes_xyxy_px"_a, "known_m"_a, R"(
Return the (N,) depths of the layers that fill the middles of people's boxes; NaN: none.

The nearest layer of about a torso's thickness that is not much smaller than the largest one is
the person; readings near the known depth are looked at alone unless they are few.

Args:
    depth_m: (H, W) float32; 0 or NaN = no reading.
    boxes_xyxy_px: (N, 4), finite, in pixels of this image.
    known_m: (N,) depths of the same people a moment ago; NaN = unknown.

Raises:
    ValueError: A box is not finite, or lengths differ.)");
}

}  // namespace

void bind_masks(nb::module_& module)
{
  bind_depths(module);
  module.def(
    "cover_things", &cover_things, "depth_m"_a, "areas_xyxy_px"_a, "depths_m"_a, "reaches_m"_a,
    "certainties"_a, "seen"_a, R"(
Return how sure it is, (H, W) uint8, that each pixel shows something that moves; 0 = static.

The image is cut into regions along the jumps of depth. A thing is the regions that lie mostly
in its area and near its depth, and the gaps without readings beside them. It may reach out of
its area by a tenth of a side, as a box is not exact; what lies further out has only merged
with it in depth, as a desk with who leans on it.

Args:
    depth_m: (H, W) float32; 0 = no reading.
    areas_xyxy_px: (N, 4) int32, whole pixels within the image, the last exclusive.
    depths_m: (N,) of the things; NaN = unknown: then a thing is its whole area.
    reaches_m: (N,) how far things reach before and behind their depth.
    certainties: (N,) uint8, how sure it is that they move.
    seen: (N,) bool, things that are there for sure: when a thing's regions are too little of its
        area, it has merged with what it touches, and all pixels near its depth count.

Raises:
    ValueError: An area is not in the image, or lengths differ.)");
  module.def("widen", &widen, "mask"_a, "reach_px"_a, R"(
Return (H, W) uint8 flags of pixels with one that is not 0 within reach along rows and columns.

Args:
    mask: (H, W) uint8.
    reach_px: 0: none.)");
  module.def("values_at", &values_at, "pixels"_a, "values"_a, "rows"_a, "columns"_a, R"(
Return values[rows[v], columns[u]] for each (u, v) of K pixels.

Args:
    pixels: (K,) int64, indices in the flat (H, W) image.
    values: (h, w) uint8.
    rows: (H,) int64, in [0, h).
    columns: (W,) int64, in [0, w).

Raises:
    ValueError: A pixel is not in the image, or a row or a column not in `values`.)");
}

}  // namespace hoid::bindings
