// Sparse optical flow: pyramids of grey images, and points that are followed from one to another.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "common/image.hpp"

namespace hoid::flow {

constexpr int kWindow =
  9;  // side of what is compared around a point, and of what lies beyond edges

// One level of a pyramid. Beyond its edges the image is mirrored, and slopes are 0.
struct Level
{
  int width, height;
  std::unique_ptr<uint8_t[]> pixels;
  std::unique_ptr<int16_t[]> slopes_x, slopes_y;  // 32 times the derivatives (Scharr)

  Level(int width, int height);

  int step() const { return width + 2 * kWindow; }
  std::ptrdiff_t index(int u, int v) const
  {
    return (static_cast<std::ptrdiff_t>(v) + kWindow) * step() + u + kWindow;
  }
};

// The levels of an image, each half as large as the one before, as far as a window fits in.
struct Pyramid
{
  std::vector<Level> levels;

  Pyramid(const Image<uint8_t>& image, int num_levels);
  Pyramid(const Pyramid&) = delete;
  Pyramid& operator=(const Pyramid&) = delete;
};

// Points in one image, and where they are looked for in another.
struct Points
{
  const float* from_px;  // (count, 2)
  int count;
};

// How points are looked for, and which count as found.
struct Search
{
  int num_levels;        // that are gone through, at most those of both pyramids
  int back_levels;       // the same on the way back
  int num_steps;         // on a level
  double least_step_px;  // below which a level is done
  float margin_px;       // from the edge of the image, within which no point counts
  float return_px;       // off the start along either axis, from which on a point has slipped
};

// Move points (count, 2) from where they are guessed to where the second image shows what the
// first one does around them. Write whether they were found, and led back to where they were.
//
// Lucas and Kanade, IJCAI 1981, on pyramids; integers and sums are those of OpenCV's
// calcOpticalFlowPyrLK (Bouguet 2001) on x86, so that both agree bit for bit.
void follow_points(
  const Pyramid& before, const Pyramid& now, const Points& points, const Search& search,
  float* uv_px, uint8_t* found);

}  // namespace hoid::flow
