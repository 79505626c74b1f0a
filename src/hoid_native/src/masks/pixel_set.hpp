// A set of the pixels of an image: one bit per pixel, so that it stays in a fast cache.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/multiversion.hpp"

namespace hoid::masks {

class PixelSet
{
public:
  PixelSet(int width, int height)
  : width_(width),
    height_(height),
    words_(static_cast<std::size_t>(width) * height / 64 + 1)
  {
  }

  // `pixel` is a flat index.
  void add(int64_t pixel) { words_[pixel >> 6] |= uint64_t{1} << (pixel & 63); }

  ALWAYS_INLINE bool has(int64_t pixel) const
  {
    return (words_[pixel >> 6] >> (pixel & 63) & 1) != 0;
  }

  // Add the pixels with their center in a box (x1, y1, x2, y2), which may extend beyond the image.
  void add_box(const double* box)
  {
    each_word(*this, box, [](uint64_t& word, uint64_t mask) {
      word |= mask;
      return false;
    });
  }

  bool has_any_in(const double* box) const
  {
    return each_word(*this, box, [](uint64_t word, uint64_t mask) { return (word & mask) != 0; });
  }

  ALWAYS_INLINE int64_t size() const
  {
    int64_t total = 0;
    for (uint64_t word : words_) {
      // Population count (Warren, Hacker's Delight, fig. 5-2), fast on any processor, unlike the
      // builtin, which needs the POPCNT extension.
      word -= word >> 1 & 0x5555555555555555;
      word = (word & 0x3333333333333333) + (word >> 2 & 0x3333333333333333);
      word = (word + (word >> 4)) & 0x0f0f0f0f0f0f0f0f;
      word += word >> 8;
      word += word >> 16;
      total += static_cast<int64_t>((word + (word >> 32)) & 0x7f);
    }
    return total;
  }

private:
  // Return the first row or column with its center at or after a position, clamped to the image.
  static int first_from(double place_px, int size)
  {
    return static_cast<int>(std::clamp(std::ceil(place_px), 0.0, static_cast<double>(size)));
  }

  // Visit the words that hold a box's pixels, with a mask of these pixels, until `visit` returns
  // true.
  template <typename Set, typename Visit>
  static bool each_word(Set& set, const double* box, Visit visit)
  {
    const int left = first_from(box[0], set.width_), right = first_from(box[2], set.width_);
    const int bottom = first_from(box[3], set.height_);
    for (int v = first_from(box[1], set.height_); v < bottom && left < right; ++v) {
      const int64_t first = static_cast<int64_t>(v) * set.width_ + left,
                    last = first + right - left - 1;
      for (int64_t word = first >> 6; word <= last >> 6; ++word) {
        uint64_t mask = ~uint64_t{0};
        mask &= word == first >> 6 ? mask << (first & 63) : mask;
        mask &= word == last >> 6 ? ~uint64_t{0} >> (63 - (last & 63)) : mask;
        if (visit(set.words_[word], mask)) {
          return true;
        }
      }
    }
    return false;
  }

  int width_, height_;
  std::vector<uint64_t> words_;
};

}  // namespace hoid::masks
