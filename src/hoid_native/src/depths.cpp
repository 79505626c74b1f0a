// Depth of what a box shows, read at the centre of the box.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

namespace {

// A square of a depth image; beyond the image it sees the image's edge.
class Square
{
public:
  Square(const float* depth_m, int width, int height, const double* box, int side)
  : depth_m_(depth_m),
    width_(width),
    height_(height),
    side_(side),
    left_(static_cast<int>(std::nearbyint((box[0] + box[2] - side) / 2))),
    top_(static_cast<int>(std::nearbyint((box[1] + box[3] - side) / 2)))
  {
  }

  // Ask for the pixels ahead of time: the image was last touched before the corners were found.
  void prefetch() const
  {
#ifdef __GNUC__
    for (int v = top_; v < top_ + side_; ++v) {
      __builtin_prefetch(at(v, left_));
      __builtin_prefetch(at(v, left_ + side_ - 1));
    }
#endif
  }

  // Write the readings, as bits: those of positive floats are in the order of their values. Return how many.
  int read(uint32_t* bits) const
  {
    int count = 0;
    for (int v = top_; v < top_ + side_; ++v) {
      for (int u = left_; u < left_ + side_; ++u) {
        const float* reading = at(v, u);
        std::memcpy(bits + count, reading, sizeof(*bits));  // overwritten by the next when it is none: no branch
        count += static_cast<int>(*reading > 0);
      }
    }
    return count;
  }

private:
  const float* at(int v, int u) const
  {
    return depth_m_ + static_cast<std::ptrdiff_t>(std::clamp(v, 0, height_ - 1)) * width_ +
           std::clamp(u, 0, width_ - 1);
  }

  const float* depth_m_;
  int width_, height_, side_, left_, top_;
};

// The value with `rank` smaller ones, found bit by bit: each step only counts, without a branch to predict.
uint32_t select(const uint32_t* bits, int count, int rank)
{
  uint32_t found = 0;
  for (uint32_t bit = uint32_t{1} << 30; bit != 0; bit >>= 1) {
    const auto middle = static_cast<int32_t>(found | bit);
    int smaller = 0;
    for (int k = 0; k < count; ++k) {
      smaller += static_cast<int>(static_cast<int32_t>(bits[k]) < middle);
    }
    found |= smaller <= rank ? bit : 0;
  }
  return found;
}

double value(uint32_t bits)
{
  float reading;
  std::memcpy(&reading, &bits, sizeof(reading));
  return reading;
}

// The median of readings, given by their bits; NaN when there are none.
double median(const uint32_t* bits, int count)
{
  if (count == 0) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const double upper = value(select(bits, count, count / 2));
  return count % 2 == 1 ? upper : (value(select(bits, count, count / 2 - 1)) + upper) / 2;
}

}  // namespace

// Write the median reading of a square at the centre of each box (x1, y1, x2, y2). Readings are positive; 0 and
// NaN are none.
extern "C" void hoid_sample_depths(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const double* boxes, int32_t side_px,
  double* median_m_out)
{
  std::vector<Square> squares;
  squares.reserve(count);
  for (int n = 0; n < count; ++n) {
    squares.emplace_back(depth_m, width, height, boxes + 4 * static_cast<std::ptrdiff_t>(n), side_px);
    squares.back().prefetch();
  }
  std::vector<uint32_t> bits(static_cast<std::size_t>(side_px) * side_px + 1);
  for (int n = 0; n < count; ++n) {
    median_m_out[n] = median(bits.data(), squares[n].read(bits.data()));
  }
}
