// Separates the object in a bounding box from the background behind it, by depth.
#pragma once

#include <cstdint>
#include <vector>

#include "objects/objects.hpp"

namespace hoid::objects {

using Pixels = std::vector<int64_t>;

// Return those of the given pixels that show the object: its surface begins at the nearest range
// of depth with many pixels, and ends behind it at the first gap in depth.
// `pixels` are the pixels of the box that have a depth, `side_px` is the longer side of the box.
Pixels nearest_part(const DepthPoints& image, const Pixels& pixels, int side_px);

}  // namespace hoid::objects
