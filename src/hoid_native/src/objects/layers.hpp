// The nearest part of what a box of a depth image shows.
#pragma once

#include <cstdint>
#include <vector>

#include "objects/objects.hpp"

namespace hoid::objects {

using Pixels = std::vector<int64_t>;

// Return the pixels of the nearest well-filled layer of depth, and behind it up to a gap in depth.
// `side_px` is the longer side of the box.
Pixels nearest_part(const DepthPoints& image, const Pixels& pixels, int side_px);

}  // namespace hoid::objects
