#include "flow/flow.hpp"

#include "bindings/arrays.hpp"
#include "bindings/checks.hpp"
#include "bindings/module.hpp"

namespace hoid::bindings {

namespace {

using namespace nb::literals;
using FlowPyramid = flow::Pyramid;
using FlowSearch = flow::Search;

HOID_RESULT(Followed);

void build(FlowPyramid* pyramid, const ImageArray<uint8_t>& image_gray, int num_levels)
{
  require_pixels("image_gray", image_gray);
  require(num_levels >= 1, "num_levels: must be at least 1");
  unlocked([&] { new (pyramid) FlowPyramid(view(image_gray), num_levels); });
}

void choose(
  FlowSearch* search, int num_levels, int back_levels, int num_steps, double least_step_px,
  float margin_px, float return_px)
{
  require(
    num_levels >= 1 && back_levels >= 1 && num_steps >= 1,
    "num_levels, back_levels and num_steps: must be at least 1");
  new (search) FlowSearch{num_levels, back_levels, num_steps, least_step_px, margin_px, return_px};
}

Followed follow_points(
  const FlowPyramid& before, const FlowPyramid& now, const Array<float, -1, 2>& from_px,
  const Array<float, -1, 2>& guess_px, const FlowSearch& search)
{
  require_length("guess_px", guess_px, from_px.size());
  const auto &first = before.levels[0], &second = now.levels[0];
  require(
    first.width == second.width && first.height == second.height,
    "now: must be as large as before");
  std::vector<float> uv_px(guess_px.data(), guess_px.data() + guess_px.array.size());
  std::vector<uint8_t> found(from_px.size());
  unlocked([&] {
    flow::follow_points(
      before, now, {from_px.data(), from_px.size()}, search, uv_px.data(), found.data());
  });
  const std::array<std::size_t, 2> rows{found.size(), 2};
  const std::array<std::size_t, 1> count{found.size()};
  return make<Followed>(
    give(std::move(uv_px), rows), give<uint8_t, bool>(std::move(found), count));
}

}  // namespace

void bind_flow(nb::module_& module)
{
  nb::class_<FlowPyramid>(module, "FlowPyramid", R"(
A grey image at halved sizes, and its slopes, in which points are followed.)")
    .def("__init__", &build, "image_gray"_a, "num_levels"_a, R"(
Take an image.

Args:
    image_gray: (H, W) uint8.
    num_levels: with the image itself; less where one would be too small.

Raises:
    ValueError: The image is empty, or there is no level.)")
    .def_prop_ro(
      "size_px",
      [](const FlowPyramid& pyramid) {
        return nb::make_tuple(pyramid.levels[0].width, pyramid.levels[0].height);
      },
      nb::sig("def size_px(self) -> tuple[int, int]"), "Width and height of the image.");
  nb::class_<FlowSearch>(module, "FlowSearch", R"(
How points are looked for, and which count as found.)")
    .def(
      "__init__", &choose, "num_levels"_a, "back_levels"_a, "num_steps"_a, "least_step_px"_a,
      "margin_px"_a, "return_px"_a, R"(
Choose.

Args:
    num_levels: that are gone through, the smallest first.
    back_levels: the same on the way back.
    num_steps: on each, at most.
    least_step_px: below which a level is done.
    margin_px: from the edge of the image, within which no point counts as found.
    return_px: off the start along either axis, from which on it does not.

Raises:
    ValueError: A number is less than 1.)");
  module.def(
    "follow_points", &follow_points, "before"_a, "now"_a, "from_px"_a, "guess_px"_a, "search"_a,
    R"(
Return where points of one image are in another, by the 9x9 pixels around them.

A point counts as found when following it back leads to where it was: else it slipped.

Args:
    before: of the one.
    now: of the other, as large.
    from_px: (N, 2) float32.
    guess_px: (N, 2) float32, where each is looked for.
    search: how.

Raises:
    ValueError: Sizes or lengths differ.

Source: Lucas and Kanade, IJCAI 1981, on pyramids, equal to OpenCV's calcOpticalFlowPyrLK.)");
}

}  // namespace hoid::bindings
