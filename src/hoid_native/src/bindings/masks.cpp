#include "masks/masks.hpp"

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;

void require_inside(const char* name, bool inside, int width, int height)
{
  if (!inside) {
    refuse(
      std::string(name) + " must be inside the image of " + std::to_string(width) + " x " +
      std::to_string(height) + " px");
  }
}

std::array<std::size_t, 2> shape_of(const auto& image)
{
  return {image.array.shape(0), image.array.shape(1)};
}

auto box_center_depths_m(const ImageArray<float>& depth_m, const BoxArray& boxes, int side_px)
{
  require_pixels("depth_m", depth_m);
  require_finite("boxes_xyxy_px", boxes);
  require(side_px >= 1, "side_px: must be at least 1");
  std::vector<double> median_m(boxes.size());
  unlocked(
    [&] { masks::box_center_depths(view(depth_m), view(boxes), side_px, median_m.data()); });
  return give(std::move(median_m));
}

auto person_depths_m(
  const ImageArray<float>& depth_m, const BoxArray& boxes, const RealArray<-1>& known_m)
{
  require_finite("boxes_xyxy_px", boxes);
  require_length("known_m", known_m, boxes.size());
  std::vector<double> person_m(boxes.size());
  unlocked(
    [&] { masks::person_depths(view(depth_m), view(boxes), known_m.data(), person_m.data()); });
  return give(std::move(person_m));
}

void require_areas(const Array<int32_t, -1, 4>& areas, int width, int height)
{
  bool inside = true;
  for (int n = 0; n < areas.size(); ++n) {
    const int32_t* area = areas.data() + 4 * static_cast<std::ptrdiff_t>(n);
    inside &= std::min({area[0], area[1], area[2], area[3]}) >= 0 &&
              std::max(area[0], area[2]) <= width && std::max(area[1], area[3]) <= height;
  }
  require_inside("areas", inside, width, height);
}

auto segment_objects(
  const ImageArray<float>& depth_m, const Array<int32_t, -1, 4>& areas,
  const RealArray<-1>& depths_m, const RealArray<-1>& reaches_m, const Vector<bool>& seen)
{
  const int count = areas.size();
  require_areas(areas, depth_m.size(1), depth_m.size(0));
  require_length("depths_m", depths_m, count);
  require_length("reaches_m", reaches_m, count);
  require_length("seen", seen, count);
  const masks::Objects objects{
    areas.data(),
    depths_m.data(),
    reaches_m.data(),
    reinterpret_cast<const uint8_t*>(seen.data()),
    count};
  std::vector<uint8_t> dynamic(depth_m.array.size());
  unlocked([&] { masks::segment_objects(view(depth_m), objects, dynamic.data()); });
  return give<uint8_t, bool>(std::move(dynamic), shape_of(depth_m));
}

auto values_at(
  const Vector<int64_t>& pixels, const ImageArray<uint8_t>& values, const Vector<int64_t>& rows,
  const Vector<int64_t>& columns)
{
  require_range("rows", rows, 0, values.size(0));
  require_range("columns", columns, 0, values.size(1));
  require_range("pixels", pixels, 0, static_cast<int64_t>(rows.size()) * columns.size());
  std::vector<uint8_t> value(pixels.size());
  const masks::Upscaling scale{rows.data(), columns.data(), columns.size()};
  unlocked([&] {
    masks::values_at(view(values), scale, pixels.data(), pixels.size(), value.data());
  });
  return give(std::move(value));
}

void bind_depths(nb::module_& module)
{
  module.def(
    "box_center_depths_m", &box_center_depths_m, "depth_m"_a, "boxes_xyxy_px"_a, "side_px"_a, R"(
Return the (N,) median depths (m) in squares at the centers of boxes; NaN without a reading.

Args:
    depth_m: (H, W) float32 depth, not empty; 0 or NaN = no reading.
    boxes_xyxy_px: (N, 4) boxes, finite.
    side_px: side of the squares, at least 1. Beyond the image, its border pixels are repeated.

Raises:
    ValueError: The image is empty, a box is not finite, or the side is less than 1.)");
  module.def("person_depths_m", &person_depths_m, "depth_m"_a, "boxes_xyxy_px"_a, "known_m"_a, R"(
Return the (N,) depths (m) of the people in boxes; NaN without a reading.

A layer is a range of depth as thick as a torso (0.4 m). The depth is the median of the nearest
layer of the readings in the middle of the box that has at least 60 % as many of them as the
fullest layer. Readings from 10 m on are not used. If the depth of the person in an earlier image
is known, only readings near this depth are used, unless there are few of them.

Args:
    depth_m: (H, W) float32 depth; 0 or NaN = no reading.
    boxes_xyxy_px: (N, 4) boxes, finite, in pixels of this depth image.
    known_m: (N,) depths of the same people in an earlier image; NaN = unknown.

Raises:
    ValueError: A box is not finite, or lengths differ.)");
}

}  // namespace

void bind_masks(nb::module_& module)
{
  bind_depths(module);
  module.def(
    "segment_objects", &segment_objects, "depth_m"_a, "areas_xyxy_px"_a, "depths_m"_a,
    "reaches_m"_a, "seen"_a, R"(
Return the (H, W) mask of the pixels that show a dynamic object.

The depth image is split into regions along depth jumps. To an object belong the regions that lie
mostly in its box and near its depth, and gaps without readings beside these regions. Because boxes
are not exact, the object may extend beyond its box by a tenth of the box's side. Parts of a region
that are further outside are not masked: they belong to something that touches the object, like the
desk on which a person leans (docs/decisions/010).

Args:
    depth_m: (H, W) float32 depth; 0 = no reading.
    areas_xyxy_px: (N, 4) int32 boxes of whole pixels within the image; x2 and y2 are exclusive.
    depths_m: (N,) depths of the objects. NaN = unknown: the whole box is masked.
    reaches_m: (N,) largest difference between an object's depth and the depths of its regions.
    seen: (N,) bool, whether the object was detected in this image and not predicted. If the
        regions of a detected object fill little of its box, the object has merged with its
        surroundings; then all pixels of the box near its depth are masked.

Raises:
    ValueError: An area is not in the image, or lengths differ.)");
  module.def("values_at", &values_at, "pixels"_a, "values"_a, "rows"_a, "columns"_a, R"(
Return the (K,) uint8 values that a small image has at pixels (u, v) of its upscaled image.

The value at a pixel is `values[rows[v], columns[u]]`. Only the K pixels are upscaled.

Args:
    pixels: (K,) int64 pixels, as indices into the flattened large (H, W) image.
    values: (h, w) uint8 small image.
    rows: (H,) int64 row of the small image for each row of the large image.
    columns: (W,) int64 column of the small image for each column of the large image.

Raises:
    ValueError: A pixel is not in the image, or a row or a column not in `values`.)");
}

}  // namespace hoid::bindings
