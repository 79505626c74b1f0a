#include "graph/observation_graph.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <queue>
#include <stdexcept>
#include <utility>

namespace hoid::graph {

namespace {

constexpr int32_t kNone = -1;

template <typename T>
void grow(std::vector<T>& values, int64_t index, const T& value = T())
{
  if (index >= static_cast<int64_t>(values.size())) {
    values.resize(std::max<std::size_t>(index + 1, 2 * values.size()), value);
  }
}

// Return the position of each keyframe (by row) in a list of keyframes, or kNone.
std::vector<int32_t> positions(const Numbers& keyframes)
{
  std::vector<int32_t> position;
  for (int n = 0; n < keyframes.count; ++n) {
    grow(position, keyframes[n], kNone);
    position[keyframes[n]] = n;
  }
  return position;
}

// Return the position of a keyframe by the result of `positions`, or kNone.
int32_t find(const std::vector<int32_t>& position, int32_t keyframe)
{
  return keyframe < static_cast<int64_t>(position.size()) ? position[keyframe] : kNone;
}

// Return the sort key of an observation: by keyframe, then by feature.
uint64_t key_of(int64_t keyframe, int64_t feature)
{
  return static_cast<uint64_t>(keyframe) << 32 | static_cast<uint64_t>(feature);
}

// Append the observation of point j by keyframe i, in the feature that a sort key holds.
void append(Observations& out, int64_t i, uint64_t key, int64_t j)
{
  out.i.push_back(i);
  out.k.push_back(static_cast<int64_t>(key & 0xFFFFFFFF));
  out.j.push_back(j);
}

// Return the distance [m] between keyframes a and b, plus m_per_rad for each radian of rotation.
double distance_m(const Transforms& T_map_camera, int64_t a, int64_t b, double m_per_rad)
{
  const double *A = T_map_camera[a], *B = T_map_camera[b];
  double trace = 0, square = 0;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      trace += A[4 * row + column] * B[4 * row + column];
    }
    square += (A[4 * row + 3] - B[4 * row + 3]) * (A[4 * row + 3] - B[4 * row + 3]);
  }
  const double turn_rad = std::acos(std::clamp((trace - 1) / 2, -1.0, 1.0));
  return std::sqrt(square) + m_per_rad * turn_rad;
}

}  // namespace

template <typename Visit>
void ObservationGraph::visit(const Numbers& j, Visit visit) const
{
  for (const int64_t point : j) {
    if (point >= static_cast<int64_t>(first_.size())) {
      continue;
    }
    for (int32_t at = first_[point]; at != kNone; at = observers_[at].next) {
      visit(observers_[at], point);
    }
  }
}

void ObservationGraph::observe(const Numbers& i, const Numbers& k, const Numbers& j)
{
  for (int n = 0; n < j.count; ++n) {
    grow(first_, j[n], kNone);
    int32_t at = static_cast<int32_t>(observers_.size());
    if (free_.empty()) {
      observers_.emplace_back();
    } else {
      at = free_.back();
      free_.pop_back();
    }
    observers_[at] = {static_cast<int32_t>(i[n]), static_cast<int32_t>(k[n]), first_[j[n]]};
    first_[j[n]] = at;
  }
}

void ObservationGraph::unobserve(const Numbers& i, const Numbers& k, const Numbers& j)
{
  for (int n = 0; n < j.count; ++n) {
    int32_t none = kNone;
    int32_t* link = j[n] < static_cast<int64_t>(first_.size()) ? &first_[j[n]] : &none;
    while (*link != kNone &&
           (observers_[*link].keyframe != i[n] || observers_[*link].feature != k[n])) {
      link = &observers_[*link].next;
    }
    if (*link == kNone) {
      throw std::invalid_argument("there is no such observation");
    }
    free_.push_back(*link);
    *link = observers_[*link].next;
  }
}

void ObservationGraph::clear() { *this = ObservationGraph(); }

Observations ObservationGraph::observations(const Numbers& j, const Numbers* keyframes) const
{
  const auto position = keyframes ? positions(*keyframes) : std::vector<int32_t>();
  std::vector<std::pair<uint64_t, int64_t>> keyed;
  visit(j, [&](const Observer& observer, int64_t point) {
    const int32_t at = keyframes ? find(position, observer.keyframe) : observer.keyframe;
    if (at != kNone) {
      keyed.emplace_back(key_of(at, observer.feature), point);
    }
  });
  std::sort(keyed.begin(), keyed.end());
  // Repeated points give equal keys.
  keyed.erase(std::unique(keyed.begin(), keyed.end()), keyed.end());
  Observations out;
  for (auto* part : {&out.i, &out.k, &out.j}) {
    part->reserve(keyed.size());
  }
  for (const auto& [key, point] : keyed) {
    const auto at = static_cast<int64_t>(key >> 32);
    append(out, keyframes ? (*keyframes)[at] : at, key, point);
  }
  return out;
}

Observations ObservationGraph::observations_by_point(const Numbers& j) const
{
  std::vector<int64_t> points(j.begin(), j.end());
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  Observations out;
  std::vector<uint64_t> keys;
  for (const int64_t point : points) {
    keys.clear();
    visit({&point, 1}, [&](const Observer& observer, int64_t) {
      keys.push_back(key_of(observer.keyframe, observer.feature));
    });
    std::sort(keys.begin(), keys.end());
    for (const uint64_t key : keys) {
      append(out, static_cast<int64_t>(key >> 32), key, point);
    }
  }
  return out;
}

void ObservationGraph::connect(int64_t i, const Numbers& j)
{
  std::vector<int64_t> counts, rows, shared;
  visit(j, [&](const Observer& observer, int64_t) {
    grow(counts, observer.keyframe, int64_t{0});
    if (counts[observer.keyframe]++ == 0 && observer.keyframe != i) {
      rows.push_back(observer.keyframe);
    }
  });
  std::sort(rows.begin(), rows.end());
  for (const int64_t row : rows) {
    shared.push_back(counts[row]);
  }
  const auto num = static_cast<int>(rows.size());
  set_neighbors(i, {rows.data(), num}, {shared.data(), num});
}

void ObservationGraph::set_neighbors(int64_t i, const Numbers& rows, const Numbers& shared)
{
  grow(connections_, i);
  for (const auto& [other, _] : std::vector<Connection>(connections_[i])) {
    if (!std::binary_search(rows.begin(), rows.end(), other)) {
      set_neighbor(other, i, 0);
    }
  }
  connections_[i].clear();
  for (int n = 0; n < rows.count; ++n) {
    grow(connections_, rows[n]);
    connections_[i].emplace_back(rows[n], shared[n]);
    set_neighbor(rows[n], i, shared[n]);
  }
}

void ObservationGraph::set_neighbor(int64_t of, int64_t neighbor, int64_t shared)
{
  std::vector<Connection>& all = connections_[of];
  const auto at = std::lower_bound(all.begin(), all.end(), Connection(neighbor, 0));
  const bool is_known = at != all.end() && at->first == neighbor;
  if (shared == 0 && is_known) {
    all.erase(at);
  } else if (is_known) {
    at->second = static_cast<int32_t>(shared);
  } else if (shared > 0) {
    all.insert(at, Connection(neighbor, shared));
  }
}

Neighbors ObservationGraph::neighbors(int64_t i, int64_t min_shared) const
{
  std::vector<Connection> found;
  if (i < static_cast<int64_t>(connections_.size())) {
    std::copy_if(
      connections_[i].begin(), connections_[i].end(), std::back_inserter(found),
      [&](const Connection& connection) { return connection.second >= min_shared; });
  }
  std::stable_sort(found.begin(), found.end(), [](const Connection& a, const Connection& b) {
    return a.second > b.second;
  });
  Neighbors out;
  for (const auto& [row, shared] : found) {
    out.rows.push_back(row);
    out.shared.push_back(shared);
  }
  return out;
}

Edges ObservationGraph::edges(int64_t min_shared) const
{
  Edges out;
  for (std::size_t i = 0; i < connections_.size(); ++i) {
    for (const auto& [other, shared] : connections_[i]) {
      if (static_cast<int64_t>(i) < other && shared >= min_shared) {
        out.first.push_back(static_cast<int64_t>(i));
        out.second.push_back(other);
        out.shared.push_back(shared);
      }
    }
  }
  return out;
}

double ObservationGraph::path_length_m(
  const SpanningTree& tree, int64_t start, int64_t goal, int64_t min_shared,
  double m_per_rad) const
{
  using Reached = std::pair<double, int64_t>;  // length of the path to a keyframe
  const int count = tree.T_map_camera.count;
  std::vector<std::vector<int64_t>> children(count);
  for (int64_t i = 0; i < count; ++i) {
    if (tree.parents[i] >= 0) {
      children[tree.parents[i]].push_back(i);
    }
  }
  std::vector<double> length(count, std::numeric_limits<double>::infinity());
  length[start] = 0;
  std::priority_queue<Reached, std::vector<Reached>, std::greater<>> queue;
  queue.emplace(0.0, start);
  while (!queue.empty()) {
    const auto [so_far, i] = queue.top();
    queue.pop();
    if (i == goal) {
      return so_far;
    }
    if (so_far > length[i]) {
      continue;
    }
    const auto reach = [&, from = i, so_far = so_far](int64_t to) {
      const double reached = so_far + distance_m(tree.T_map_camera, from, to, m_per_rad);
      if (reached < length[to]) {
        length[to] = reached;
        queue.emplace(reached, to);
      }
    };
    if (i < static_cast<int64_t>(connections_.size())) {
      for (const auto& [other, shared] : connections_[i]) {
        if (shared >= min_shared && other < count) {
          reach(other);
        }
      }
    }
    std::for_each(children[i].begin(), children[i].end(), reach);
    if (tree.parents[i] >= 0) {
      reach(tree.parents[i]);
    }
  }
  return std::numeric_limits<double>::infinity();
}

std::vector<int64_t> ObservationGraph::count_observed(
  const Numbers& j, const Numbers& keyframes) const
{
  const std::vector<int32_t> position = positions(keyframes);
  std::vector<int64_t> counts(keyframes.count);
  visit(j, [&](const Observer& observer, int64_t) {
    if (const int32_t at = find(position, observer.keyframe); at != kNone) {
      ++counts[at];
    }
  });
  return counts;
}

std::vector<int64_t> ObservationGraph::points_of(
  const Image<int32_t>& table, const Numbers& keyframes)
{
  if (++search_ == 0) {  // the counter has overflowed
    std::fill(marks_.begin(), marks_.end(), 0);
    search_ = 1;
  }
  std::vector<int64_t> found;
  for (const int64_t keyframe : keyframes) {
    const int32_t* points = table.row(static_cast<int>(keyframe));
    for (int k = 0; k < table.width; ++k) {
      if (points[k] == kNone) {
        continue;
      }
      grow(marks_, points[k], uint32_t{0});
      if (std::exchange(marks_[points[k]], search_) != search_) {
        found.push_back(points[k]);
      }
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace hoid::graph
