// Boxes (x1, y1, x2, y2): how much of them lies in others, and which pixels lie in them.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

extern "C" void hoid_sample_depths(
  const float*, int32_t, int32_t, int32_t, const double*, int32_t, double*);

namespace {

double side(double first, double last) { return std::max(last - first, 0.0); }

double area(const double* box) { return side(box[0], box[2]) * side(box[1], box[3]); }

double shared_area(const double* a, const double* b)
{
  return side(std::max(a[0], b[0]), std::min(a[2], b[2])) * side(std::max(a[1], b[1]), std::min(a[3], b[3]));
}

double ratio(double part, double whole) { return whole > 0 ? part / whole : 0.0; }

template <typename Visit>
void each_pair(int count, const double* boxes, int count_others, const double* others, Visit visit)
{
  for (int n = 0; n < count; ++n) {
    for (int m = 0; m < count_others; ++m) {
      visit(boxes + 4 * static_cast<std::ptrdiff_t>(n), others + 4 * static_cast<std::ptrdiff_t>(m));
    }
  }
}

// The first pixel of a row or column whose centre is not before a place.
int first_from(double place_px, int size)
{
  return static_cast<int>(std::clamp(std::ceil(place_px), 0.0, static_cast<double>(size)));
}

// A bit for each pixel of an image: small enough for the fastest cache.
class Bits
{
public:
  Bits(int width, int height) : width_(width), height_(height), words_(static_cast<std::size_t>(width) * height / 64 + 1)
  {
  }

  void set(int64_t pixel) { words_[pixel >> 6] |= uint64_t{1} << (pixel & 63); }

  bool at(int64_t pixel) const { return (words_[pixel >> 6] >> (pixel & 63) & 1) != 0; }

  void fill(const double* box)
  {
    each_word(box, [](uint64_t& word, uint64_t mask) {
      word |= mask;
      return false;
    });
  }

  bool any_in(const double* box)
  {
    return each_word(box, [](uint64_t& word, uint64_t mask) { return (word & mask) != 0; });
  }

  int count() const
  {
    int total = 0;
    for (uint64_t word : words_) {
      // Hacker's Delight, fig. 5-2: unlike the builtin it needs no newer processor to be fast.
      word -= word >> 1 & 0x5555555555555555;
      word = (word & 0x3333333333333333) + (word >> 2 & 0x3333333333333333);
      word = (word + (word >> 4)) & 0x0f0f0f0f0f0f0f0f;
      total += static_cast<int>((word * 0x0101010101010101) >> 56);
    }
    return total;
  }

private:
  // Visit the words that pixels of a box lie in, with the bits of those; stop when told so.
  template <typename Visit>
  bool each_word(const double* box, Visit visit)
  {
    const int left = first_from(box[0], width_), right = first_from(box[2], width_);
    const int bottom = first_from(box[3], height_);
    for (int v = first_from(box[1], height_); v < bottom && left < right; ++v) {
      const int64_t first = static_cast<int64_t>(v) * width_ + left, last = first + right - left - 1;
      for (int64_t word = first >> 6; word <= last >> 6; ++word) {
        uint64_t mask = ~uint64_t{0};
        mask &= word == first >> 6 ? mask << (first & 63) : mask;
        mask &= word == last >> 6 ? ~uint64_t{0} >> (63 - (last & 63)) : mask;
        if (visit(words_[word], mask)) {
          return true;
        }
      }
    }
    return false;
  }

  int width_, height_;
  std::vector<uint64_t> words_;
};

}  // namespace

// Write the (count, count_others) shares of each box's own area that lie in each of the others; 0 without area.
extern "C" void hoid_overlap_ratios(
  int32_t count, const double* boxes, int32_t count_others, const double* others, double* ratio_out)
{
  each_pair(count, boxes, count_others, others, [&](const double* box, const double* other) {
    *ratio_out++ = ratio(shared_area(box, other), area(box));
  });
}

// Write the (count, count_others) ratios of shared area to joint area; 0 without area.
extern "C" void hoid_intersections_over_union(
  int32_t count, const double* boxes, int32_t count_others, const double* others, double* ratio_out)
{
  each_pair(count, boxes, count_others, others, [&](const double* box, const double* other) {
    const double shared = shared_area(box, other);
    *ratio_out++ = ratio(shared, area(box) + area(other) - shared);
  });
}

// Judge boxes by the rules of the HOID paper; each is a person (role 1), may be handled (2), or neither (0).
//
// A person handles an object of which it covers more than `min_share`, or which it touches by (count, M) flags
// where these are given, unless they are `apart_m` or more apart in depth. Write in rows of `count` values: depths;
// overlap with and depth gap to the person who handles the object and covers most of it, 0 and NaN for people; and
// whether each moves.
extern "C" void hoid_judge_boxes(
  const float* depth_m, int32_t width, int32_t height, int32_t count, const double* boxes, const uint8_t* roles,
  int32_t side_px, double min_share, double apart_m, const uint8_t* touches, double* out)
{
  hoid_sample_depths(depth_m, width, height, count, boxes, side_px, out);
  std::vector<int> people;
  for (int n = 0; n < count; ++n) {
    if (roles[n] == 1) {
      people.push_back(n);
    }
  }
  double *overlap_out = out + count, *gap_out = overlap_out + count, *moves_out = gap_out + count;
  for (int n = 0; n < count; ++n) {
    const double own = area(boxes + 4 * n);
    double most = -1, most_overlap = 0, gap_m = std::numeric_limits<double>::quiet_NaN();
    bool handled = false;
    for (const int person : people) {
      const double overlap = ratio(shared_area(boxes + 4 * n, boxes + 4 * person), own);
      const double between_m = std::abs(out[n] - out[person]);
      const bool touched = touches != nullptr ? *touches++ != 0 : overlap > min_share;
      const bool by_this = touched && !(between_m >= apart_m);  // NaN: not apart
      handled = handled || by_this;
      if (overlap + by_this > most) {
        most = overlap + by_this;
        most_overlap = overlap;
        gap_m = between_m;
      }
    }
    const bool is_person = roles[n] == 1;
    overlap_out[n] = is_person ? 0 : most_overlap;
    gap_out[n] = is_person ? std::numeric_limits<double>::quiet_NaN() : gap_m;
    moves_out[n] = is_person || (handled && roles[n] == 2) ? 1 : 0;
  }
}

// Write which of the pixels, given as indices in the flat image, lie outside all boxes: their places among the
// pixels, ascending. Return how many these are, and write how many pixels of the image are outside.
extern "C" int32_t hoid_outside_boxes(
  int32_t width, int32_t height, int32_t count, const double* boxes, int32_t num_pixels, const int64_t* pixels,
  int64_t* place_out, int64_t* area_out)
{
  Bits covered(width, height);
  for (int n = 0; n < count; ++n) {
    covered.fill(boxes + 4 * static_cast<std::ptrdiff_t>(n));
  }
  *area_out = static_cast<int64_t>(width) * height - covered.count();
  int32_t num_outside = 0;
  for (int k = 0; k < num_pixels; ++k) {
    place_out[num_outside] = k;  // overwritten by the next when this one is inside: no branch to predict
    num_outside += static_cast<int32_t>(!covered.at(pixels[k]));
  }
  return num_outside;
}

// Write which boxes hold one of the pixels, given as indices in the flat image.
extern "C" void hoid_boxes_holding(
  int32_t width, int32_t height, int32_t count, const double* boxes, int32_t num_pixels, const int64_t* pixels,
  uint8_t* holds_out)
{
  Bits present(width, height);
  for (int k = 0; k < num_pixels; ++k) {
    present.set(pixels[k]);
  }
  for (int n = 0; n < count; ++n) {
    holds_out[n] = static_cast<uint8_t>(present.any_in(boxes + 4 * static_cast<std::ptrdiff_t>(n)));
  }
}

// Write, for pixels given as indices in a flat image of some width, rows[v] + columns[u].
extern "C" void hoid_cells_of(
  int32_t width, const int64_t* rows, const int64_t* columns, int32_t num_pixels, const int64_t* pixels,
  int64_t* cell_out)
{
  const double per_width = 1.0 / width;
  for (int k = 0; k < num_pixels; ++k) {
    // Half a pixel from every border of rows, which is more than the error of the product; faster than a division.
    const auto v = static_cast<int64_t>((static_cast<double>(pixels[k]) + 0.5) * per_width);
    cell_out[k] = rows[v] + columns[pixels[k] - v * width];
  }
}
