#include "flow/flow.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstring>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

#include "common/multiversion.hpp"

namespace hoid::flow {

namespace {

constexpr int kLanes = 8, kTail = kWindow - 1;  // columns at once, and the one that is left
static_assert(kTail == kLanes);

constexpr float kHalf = (kWindow - 1) * 0.5F;
constexpr int kWeightBits = 14, kPixelBits = 5;  // fractions of weights, and of pixels between
constexpr float kScale = 1.0F / (1 << 20);       // of products of two numbers with such fractions
constexpr float kLeastEigenvalue = 1e-4F;        // of the slopes' matrix: less has no texture
constexpr double kTurnPx = 0.01;                 // a step that undoes the last one

using Bytes = uint8_t __attribute__((vector_size(kLanes)));
using Words = int16_t __attribute__((vector_size(kLanes * sizeof(int16_t))));
using Ints = int32_t __attribute__((vector_size(kLanes / 2 * sizeof(int32_t))));
using Floats = float __attribute__((vector_size(kLanes / 2 * sizeof(float))));

ALWAYS_INLINE Words load(const uint8_t* at)
{
  Bytes bytes;
  std::memcpy(&bytes, at, sizeof(bytes));
  return __builtin_convertvector(bytes, Words);
}

ALWAYS_INLINE Words load(const int16_t* at)
{
  Words words;
  std::memcpy(&words, at, sizeof(words));
  return words;
}

// a0 b0 a1 b1 ... of the first halves, and of the second.
ALWAYS_INLINE Words zip_first(Words a, Words b)
{
  return __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11);
}

ALWAYS_INLINE Words zip_second(Words a, Words b)
{
  return __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15);
}

// a0 * b0 + a1 * b1, a2 * b2 + a3 * b3, ...
ALWAYS_INLINE Ints sums_of_products(Words a, Words b)
{
#if defined(__SSE2__)
  return reinterpret_cast<Ints>(
    _mm_madd_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#else
  const Ints x = reinterpret_cast<Ints>(a), y = reinterpret_cast<Ints>(b);
  return ((x << 16) >> 16) * ((y << 16) >> 16) + (x >> 16) * (y >> 16);
#endif
}

// Both as words, which they fit into.
ALWAYS_INLINE Words packed(Ints a, Ints b)
{
#if defined(__SSE2__)
  return reinterpret_cast<Words>(
    _mm_packs_epi32(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#else
  return __builtin_shufflevector(
    reinterpret_cast<Words>(a), reinterpret_cast<Words>(b), 0, 2, 4, 6, 8, 10, 12, 14);
#endif
}

ALWAYS_INLINE float sum(Floats lanes)
{
  return (lanes[0] + lanes[2]) + (lanes[1] + lanes[3]);
}

ALWAYS_INLINE int rounded(float value)
{
  return static_cast<int>(std::lrintf(value));
}

// How the four pixels around a place between them are weighted.
struct Weights
{
  int of[4];  // left and right, above, then below; they sum up to 1 << kWeightBits
  Words above, below;

  ALWAYS_INLINE Weights(float right, float under)
  {
    constexpr auto kOne = static_cast<float>(1 << kWeightBits);
    of[0] = rounded((1.0F - right) * (1.0F - under) * kOne);
    of[1] = rounded(right * (1.0F - under) * kOne);
    of[2] = rounded((1.0F - right) * under * kOne);
    of[3] = (1 << kWeightBits) - of[0] - of[1] - of[2];
    const auto pairs = [](int a, int b) {
      const auto x = static_cast<int16_t>(a), y = static_cast<int16_t>(b);
      return Words{x, y, x, y, x, y, x, y};
    };
    above = pairs(of[0], of[1]);
    below = pairs(of[2], of[3]);
  }

  // Between two pixels in each of two rows.
  ALWAYS_INLINE int mix(const uint8_t* row, const uint8_t* next, int bits) const
  {
    const int value = row[0] * of[0] + row[1] * of[1] + next[0] * of[2] + next[1] * of[3];
    return (value + (1 << (bits - 1))) >> bits;
  }
};

// Pairs of neighbours of eight places: of the first four, and of the rest.
struct Pairs
{
  Words first, second;

  template <typename T>
  static ALWAYS_INLINE Pairs in_row(const T* at)
  {
    const Words left = load(at), right = load(at + 1);
    return {zip_first(left, right), zip_second(left, right)};
  }

  static ALWAYS_INLINE Pairs of(const uint8_t* pairs)
  {
    return {load(pairs), load(pairs + kLanes)};
  }
};

ALWAYS_INLINE Words mixed(const Pairs& row, const Pairs& next, const Weights& weights, int bits)
{
  const Ints half = Ints{} + (1 << (bits - 1));
  const Ints first = sums_of_products(row.first, weights.above) +
                     sums_of_products(next.first, weights.below) + half;
  const Ints second = sums_of_products(row.second, weights.above) +
                      sums_of_products(next.second, weights.below) + half;
  return packed(first >> bits, second >> bits);
}

constexpr int kToPixels = kWeightBits - kPixelBits, kToSlopes = kWeightBits;

// Where a window begins, or that it lies too far out of the image.
struct Corner
{
  int u = 0, v = 0;
  float right = 0, under = 0;  // of the pixel
  bool inside;

  ALWAYS_INLINE Corner(float x, float y, const Level& level)
  {
    inside = x >= -kWindow && y >= -kWindow && x < static_cast<float>(level.width) &&
             y < static_cast<float>(level.height);
    if (inside) {
      u = static_cast<int>(std::floor(x));
      v = static_cast<int>(std::floor(y));
      right = x - static_cast<float>(u);
      under = y - static_cast<float>(v);
    }
  }
};

// The last column of a window, one below the other: pairs of each pixel and its right neighbour.
struct TailColumn
{
  uint8_t pairs[2 * (kWindow + 1)];

  ALWAYS_INLINE TailColumn(const uint8_t* pixel, int step)
  {
    for (int y = 0; y <= kWindow; ++y) {
      std::memcpy(pairs + 2 * y, pixel + y * static_cast<std::ptrdiff_t>(step) + kTail, 2);
    }
  }

  ALWAYS_INLINE Words mixed_rows(const Weights& weights) const
  {
    return mixed(Pairs::of(pairs), Pairs::of(pairs + 2), weights, kToPixels);
  }

  ALWAYS_INLINE int mixed_last(const Weights& weights) const
  {
    return weights.mix(pairs + 2 * kTail, pairs + 2 * kWindow, kToPixels);
  }
};

// Add the first two lanes, then the others: sums of floats depend on their order.
ALWAYS_INLINE void add_in_turn(Floats& sums, Floats lanes)
{
  sums += lanes;
  sums += __builtin_shufflevector(lanes, lanes, 2, 3, 2, 3);
}

// What the first image shows around a point.
struct Window
{
  Words pixels[kWindow];
  // Slopes along rows of columns 0 4, then along columns, then of columns 1 5; and 2 6, 3 7: so
  // sums of products with differences are those of one axis.
  Words slopes[kWindow][2];
  // The last column: pixels of all rows but one, and of that; slopes along rows, 0, along columns,
  // 0, of two rows each.
  Words tail_pixels;
  int last_pixel;
  Words tail_slopes[kWindow / 2 + 1];
  float xx, xy, yy;  // sums of products of slopes

  ALWAYS_INLINE Window(const Level& level, const Corner& corner)
  {
    const Weights weights(corner.right, corner.under);
    const std::ptrdiff_t start = level.index(corner.u, corner.v);
    const uint8_t* pixel = level.pixels.get() + start;
    const int16_t *slope_x = level.slopes_x.get() + start, *slope_y = level.slopes_y.get() + start;
    const int step = level.step();
    const TailColumn tail(pixel, step);
    const Floats tails = take_tail_slopes(slope_x + kTail, slope_y + kTail, step, weights);
    Floats sum_xx{}, sum_xy{}, sum_yy{};
    const auto add = [&](Words xy_words) {
      const Ints both = reinterpret_cast<Ints>(xy_words);
      const Floats x = __builtin_convertvector((both << 16) >> 16, Floats);
      const Floats y = __builtin_convertvector(both >> 16, Floats);
      sum_xx += x * x;
      sum_xy += x * y;
      sum_yy += y * y;
    };
    Pairs above = Pairs::in_row(pixel), above_x = Pairs::in_row(slope_x),
          above_y = Pairs::in_row(slope_y);
    for (int y = 0; y < kWindow; ++y) {
      pixel += step, slope_x += step, slope_y += step;
      const Pairs below = Pairs::in_row(pixel), below_x = Pairs::in_row(slope_x),
                  below_y = Pairs::in_row(slope_y);
      pixels[y] = mixed(above, below, weights, kToPixels);
      const Words along_x = mixed(above_x, below_x, weights, kToSlopes);
      const Words along_y = mixed(above_y, below_y, weights, kToSlopes);
      const Words left = zip_first(along_x, along_y), right = zip_second(along_x, along_y);
      add(left);
      add(right);
      slopes[y][0] = zip_first(left, right);
      slopes[y][1] = zip_second(left, right);
      above = below, above_x = below_x, above_y = below_y;
    }
    tail_pixels = tail.mixed_rows(weights);
    last_pixel = tail.mixed_last(weights);
    xx = (tails[0] + sum(sum_xx)) * kScale;
    xy = (tails[2] + sum(sum_xy)) * kScale;
    yy = (tails[1] + sum(sum_yy)) * kScale;
  }

  // Return the sums of products of slopes of the last column: xx, yy and xy.
  ALWAYS_INLINE Floats take_tail_slopes(
    const int16_t* slope_x, const int16_t* slope_y, int step, const Weights& weights)
  {
    // Of two rows: x and its right neighbour, y and its.
    const auto pairs = [&](int y, int next) {
      const std::ptrdiff_t a = static_cast<std::ptrdiff_t>(y) * step,
                           b = static_cast<std::ptrdiff_t>(next) * step;
      return Words{slope_x[a], slope_x[a + 1], slope_y[a], slope_y[a + 1],
                   slope_x[b], slope_x[b + 1], slope_y[b], slope_y[b + 1]};
    };
    const Ints half = Ints{} + (1 << (kToSlopes - 1));
    Floats squares{}, mixed_products{};
    for (int k = 0; k <= kWindow / 2; ++k) {
      const bool is_last = k == kWindow / 2;
      const int y = 2 * k, next = is_last ? y : y + 1;
      const Ints both = (sums_of_products(pairs(y, next), weights.above) +
                         sums_of_products(pairs(y + 1, next + 1), weights.below) + half) >>
                        kToSlopes;
      const Ints kept = is_last ? both & Ints{-1, -1, 0, 0} : both;
      tail_slopes[k] = reinterpret_cast<Words>(kept & 0xffff);
      const Floats values = __builtin_convertvector(kept, Floats);
      add_in_turn(squares, values * values);
      add_in_turn(mixed_products, values * __builtin_shufflevector(values, values, 1, 0, 3, 2));
    }
    return Floats{squares[0], squares[1], mixed_products[0], 0};
  }

  float determinant() const { return xx * yy - xy * xy; }

  bool has_texture() const
  {
    const float root = std::sqrt((xx - yy) * (xx - yy) + 4.0F * xy * xy);
    return (yy + xx - root) / (2 * kWindow * kWindow) >= kLeastEigenvalue &&
           determinant() >= FLT_EPSILON;
  }

  // Sum up the products of slopes, along rows and columns, with what another image differs by.
  ALWAYS_INLINE void compare(
    const Level& level, const Corner& corner, float& x_out, float& y_out) const
  {
    const Weights weights(corner.right, corner.under);
    const uint8_t* pixel = level.pixels.get() + level.index(corner.u, corner.v);
    const int step = level.step();
    const TailColumn tail(pixel, step);
    Floats first{}, second{};  // each: columns 0 4 along rows, then along columns, 1 5 ...
    Pairs above = Pairs::in_row(pixel);
    for (int y = 0; y < kWindow; ++y) {
      pixel += step;
      const Pairs below = Pairs::in_row(pixel);
      const Words off = mixed(above, below, weights, kToPixels) - pixels[y];
      const Words begin = __builtin_shufflevector(off, off, 0, 4, 0, 4, 1, 5, 1, 5);
      const Words end = __builtin_shufflevector(off, off, 2, 6, 2, 6, 3, 7, 3, 7);
      first += __builtin_convertvector(sums_of_products(begin, slopes[y][0]), Floats);
      second += __builtin_convertvector(sums_of_products(end, slopes[y][1]), Floats);
      above = below;
    }
    const Floats both = first + second, tails = compare_tail(tail, weights);
    x_out = (tails[0] + (both[0] + both[2])) * kScale;
    y_out = (tails[1] + (both[1] + both[3])) * kScale;
  }

  // Return the same of the last column, in the first two lanes.
  ALWAYS_INLINE Floats compare_tail(const TailColumn& tail, const Weights& weights) const
  {
    const Words off = tail.mixed_rows(weights) - tail_pixels;
    const auto last = static_cast<int16_t>(tail.mixed_last(weights) - last_pixel);
    Floats sums{};
    const auto add = [&](Words pairs, int k) {
      add_in_turn(sums, __builtin_convertvector(sums_of_products(pairs, tail_slopes[k]), Floats));
    };
    add(__builtin_shufflevector(off, off, 0, 0, 0, 0, 1, 1, 1, 1), 0);
    add(__builtin_shufflevector(off, off, 2, 2, 2, 2, 3, 3, 3, 3), 1);
    add(__builtin_shufflevector(off, off, 4, 4, 4, 4, 5, 5, 5, 5), 2);
    add(__builtin_shufflevector(off, off, 6, 6, 6, 6, 7, 7, 7, 7), 3);
    add(Words{} + last, 4);
    return sums;
  }
};

// Move one point on one level; false: it cannot be told there.
ALWAYS_INLINE bool follow_on_level(
  const Level& before, const Level& now, const float* from_px, const Search& search, float* at_px)
{
  const Corner start(from_px[0] - kHalf, from_px[1] - kHalf, before);
  if (!start.inside) {
    return false;
  }
  const Window window(before, start);
  if (!window.has_texture()) {
    return false;
  }
  const float inverse = 1.0F / window.determinant();
  float x = at_px[0] - kHalf, y = at_px[1] - kHalf, last_x = 0, last_y = 0;
  for (int k = 0; k < search.num_steps; ++k) {
    const Corner corner(x, y, now);
    if (!corner.inside) {
      return false;
    }
    float along_x, along_y;
    window.compare(now, corner, along_x, along_y);
    const float step_x = (window.xy * along_y - window.yy * along_x) * inverse;
    const float step_y = (window.xy * along_x - window.xx * along_y) * inverse;
    x += step_x;
    y += step_y;
    at_px[0] = x + kHalf;
    at_px[1] = y + kHalf;
    const double dx = step_x, dy = step_y;
    if (dx * dx + dy * dy <= search.least_step_px * search.least_step_px) {
      break;
    }
    if (k > 0 && std::abs(step_x + last_x) < kTurnPx && std::abs(step_y + last_y) < kTurnPx) {
      at_px[0] -= step_x * 0.5F;
      at_px[1] -= step_y * 0.5F;
      break;
    }
    last_x = step_x;
    last_y = step_y;
  }
  return true;
}

MULTIVERSION("avx2")
void follow_one_way(
  const Pyramid& before, const Pyramid& now, const Points& points, int num_levels,
  const Search& search, float* uv_px, uint8_t* found)
{
  const auto built = static_cast<int>(std::min(before.levels.size(), now.levels.size()));
  const int top = std::min(num_levels, built) - 1;
  for (int level = top; level >= 0; --level) {
    const float scale = 1.0F / static_cast<float>(1 << level);
    for (int n = 0; n < points.count; ++n) {
      const float* from = points.from_px + 2 * static_cast<std::ptrdiff_t>(n);
      float* at = uv_px + 2 * static_cast<std::ptrdiff_t>(n);
      const float from_px[2] = {from[0] * scale, from[1] * scale};
      const float grow = level == top ? scale : 2.0F;
      at[0] *= grow;
      at[1] *= grow;
      found[n] = follow_on_level(before.levels[level], now.levels[level], from_px, search, at);
    }
  }
}

}  // namespace

void follow_points(
  const Pyramid& before, const Pyramid& now, const Points& points, const Search& search,
  float* uv_px, uint8_t* found)
{
  const int size = 2 * points.count;
  std::vector<float> back_px(uv_px, uv_px + size);
  follow_one_way(before, now, points, search.num_levels, search, uv_px, found);
  for (int k = 0; k < size; ++k) {
    back_px[k] = uv_px[k] - (back_px[k] - points.from_px[k]);
  }
  std::vector<uint8_t> returned(points.count);
  follow_one_way(
    now, before, {uv_px, points.count}, search.back_levels, search, back_px.data(),
    returned.data());
  const auto last_u = static_cast<float>(now.levels[0].width - 1) - search.margin_px,
             last_v = static_cast<float>(now.levels[0].height - 1) - search.margin_px;
  for (int n = 0; n < points.count; ++n) {
    const float u = uv_px[2 * n], v = uv_px[2 * n + 1];
    const bool inside =
      u >= search.margin_px && v >= search.margin_px && u <= last_u && v <= last_v;
    const float off_px = std::max(
      std::abs(back_px[2 * n] - points.from_px[2 * n]),
      std::abs(back_px[2 * n + 1] - points.from_px[2 * n + 1]));
    found[n] = found[n] && returned[n] && inside && off_px < search.return_px;
  }
}

}  // namespace hoid::flow
