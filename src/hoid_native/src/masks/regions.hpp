// Regions of a depth image: connected smooth pixels, separated by depth jumps.
#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

#include "common/multiversion.hpp"
#include "common/views.hpp"

namespace hoid::masks {

// Chosen: a depth jump is at least 0.02 m plus 3 % of the depth over 3x3 pixels, so that noise and
// slanted surfaces do not split a region. Pixels without a measurement count as depth 0.
constexpr float kJumpM = 0.02F, kJumpShare = 0.03F;

// Write for each pixel of a row whether it is smooth: it has a reading, and there is no depth jump
// in the 3x3 pixels around it. `low` and `high` are buffers of width + 2 for the minimum and
// maximum of each column.
ALWAYS_INLINE void find_smooth(
  const float* above, const float* row, const float* below, int width, float* low, float* high,
  uint8_t* smooth)
{
  for (int x = 0; x < width; ++x) {
    low[x + 1] = std::min(row[x], std::min(above[x], below[x]));
    high[x + 1] = std::max(row[x], std::max(above[x], below[x]));
  }
  low[0] = low[1], low[width + 1] = low[width];
  high[0] = high[1], high[width + 1] = high[width];
  for (int x = 0; x < width; ++x) {
    const float most = std::max(high[x], std::max(high[x + 1], high[x + 2]));
    const float least = std::min(low[x], std::min(low[x + 1], low[x + 2]));
    smooth[x] = static_cast<uint8_t>((most - least < kJumpM + kJumpShare * row[x]) & (row[x] > 0));
  }
}

// Consecutive smooth pixels of a row: columns [first, last), all in one region.
struct Run
{
  int first, last, region;

  int overlap(int x1, int x2) const { return std::min(last, x2) - std::max(first, x1); }
};

// The connected components (4 neighbors) of smooth pixels, by runs and union-find.
class Regions
{
public:
  ALWAYS_INLINE explicit Regions(const Image<float>& depth_m) : row_start_(1, 0)
  {
    const int width = depth_m.width, last = depth_m.height - 1;
    std::vector<float> low(width + 2), high(width + 2);
    std::vector<uint8_t> smooth(width + 1, 0);  // a zero at the end closes the last run
    for (int y = 0; y <= last; ++y) {
      find_smooth(
        depth_m.row(std::max(y - 1, 0)), depth_m.row(y), depth_m.row(std::min(y + 1, last)), width,
        low.data(), high.data(), smooth.data());
      add_runs(smooth.data(), width);
    }
    number_roots();
    measure(depth_m);
  }

  int count() const { return static_cast<int>(size.size()); }

  // The runs of row y, from left to right.
  const Run* begin(int y) const { return runs_.data() + row_start_[y]; }
  const Run* end(int y) const { return runs_.data() + row_start_[y + 1]; }

  std::vector<int> size;       // number of pixels of each region
  std::vector<double> mean_m;  // mean depth of each region

private:
  void add_runs(const uint8_t* smooth, int width)
  {
    std::size_t above = row_start_.size() > 1 ? row_start_[row_start_.size() - 2] : 0;
    const std::size_t above_end = row_start_.back();
    for (int first = 0, last = 0; first < width; first = last + 1) {
      for (last = first; smooth[last] != 0; ++last) {
      }
      if (last == first) {
        continue;
      }
      const int label = static_cast<int>(parent_.size());
      parent_.push_back(label);
      runs_.push_back({first, last, label});
      for (; above < above_end && runs_[above].last <= first; ++above) {
      }
      for (std::size_t run = above; run < above_end && runs_[run].first < last; ++run) {
        join(label, runs_[run].region);
      }
    }
    row_start_.push_back(runs_.size());
  }

  int root(int label)
  {
    while (parent_[label] != label) {
      label = parent_[label] = parent_[parent_[label]];
    }
    return label;
  }

  void join(int a, int b)
  {
    a = root(a), b = root(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

  // Number the regions without gaps. A parent always precedes its children.
  void number_roots()
  {
    int num = 0;
    for (std::size_t label = 0; label < parent_.size(); ++label) {
      const bool is_root = parent_[label] == static_cast<int>(label);
      parent_[label] = is_root ? num++ : parent_[parent_[label]];
    }
    size.assign(num, 0);
    mean_m.assign(num, 0.0);
  }

  void measure(const Image<float>& depth_m)
  {
    for (int y = 0; y < depth_m.height; ++y) {
      const float* row = depth_m.row(y);
      for (std::size_t n = row_start_[y]; n < row_start_[y + 1]; ++n) {
        Run& run = runs_[n];
        run.region = parent_[run.region];
        size[run.region] += run.last - run.first;
        mean_m[run.region] += std::accumulate(row + run.first, row + run.last, 0.0);
      }
    }
    for (int r = 0; r < count(); ++r) {
      mean_m[r] /= size[r];
    }
  }

  std::vector<int> parent_;  // union-find parent of each label; a run starts with its own label
  std::vector<Run> runs_;
  std::vector<std::size_t> row_start_;
};

}  // namespace hoid::masks
