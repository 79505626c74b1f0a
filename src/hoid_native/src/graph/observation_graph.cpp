#include "graph/observation_graph.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>
#include <stdexcept>

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
std::vector<int32_t> positions(const int64_t* keyframes, int count)
{
  std::vector<int32_t> position;
  for (int n = 0; n < count; ++n) {
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

// Return observations, given as pairs (key, point), in the order of their keys. A key holds a
// keyframe and a feature; if `rows` is given, the keyframe is a position in this list.
Observations sorted(
  std::vector<std::pair<uint64_t, int64_t>>&& keyed, const int64_t* rows = nullptr)
{
  std::sort(keyed.begin(), keyed.end());
  keyed.erase(std::unique(keyed.begin(), keyed.end()), keyed.end());  // of repeated points
  Observations out;
  for (auto* part : {&out.i, &out.k, &out.j}) {
    part->reserve(keyed.size());
  }
  for (const auto& [key, j] : keyed) {
    const auto at = static_cast<int64_t>(key >> 32);
    append(out, rows ? rows[at] : at, key, j);
  }
  return out;
}

// Return the distance [m] between keyframes a and b, plus m_per_rad for each radian of rotation.
double distance_m(const Poses& poses, int64_t a, int64_t b, double m_per_rad)
{
  const double *A = poses.T_map_camera + 16 * a, *B = poses.T_map_camera + 16 * b;
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
void ObservationGraph::visit(const int64_t* j, int count, Visit visit) const
{
  for (int n = 0; n < count; ++n) {
    if (j[n] >= static_cast<int64_t>(first_.size())) {
      continue;
    }
    for (int32_t at = first_[j[n]]; at != kNone; at = observers_[at].next) {
      visit(observers_[at], j[n]);
    }
  }
}

void ObservationGraph::observe(const int64_t* i, const int64_t* k, const int64_t* j, int count)
{
  for (int n = 0; n < count; ++n) {
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

void ObservationGraph::unobserve(const int64_t* i, const int64_t* k, const int64_t* j, int count)
{
  for (int n = 0; n < count; ++n) {
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

Observations ObservationGraph::observations(const int64_t* j, int count) const
{
  std::vector<std::pair<uint64_t, int64_t>> keyed;
  visit(j, count, [&](const Observer& observer, int64_t point) {
    keyed.emplace_back(key_of(observer.keyframe, observer.feature), point);
  });
  return sorted(std::move(keyed));
}

Observations ObservationGraph::observations_by_point(const int64_t* j, int count) const
{
  std::vector<int64_t> points(j, j + count);
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  Observations out;
  std::vector<uint64_t> keys;
  for (const int64_t point : points) {
    keys.clear();
    visit(&point, 1, [&](const Observer& observer, int64_t) {
      keys.push_back(key_of(observer.keyframe, observer.feature));
    });
    std::sort(keys.begin(), keys.end());
    for (const uint64_t key : keys) {
      append(out, static_cast<int64_t>(key >> 32), key, point);
    }
  }
  return out;
}

Observations ObservationGraph::observations_by(
  const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const
{
  const std::vector<int32_t> position = positions(keyframes, num_keyframes);
  std::vector<std::pair<uint64_t, int64_t>> keyed;
  visit(j, count, [&](const Observer& observer, int64_t point) {
    if (const int32_t at = find(position, observer.keyframe); at != kNone) {
      keyed.emplace_back(key_of(at, observer.feature), point);
    }
  });
  return sorted(std::move(keyed), keyframes);
}

void ObservationGraph::connect(int64_t i, const int64_t* j, int count)
{
  std::vector<int64_t> counts, rows, shared;
  visit(j, count, [&](const Observer& observer, int64_t) {
    grow(counts, observer.keyframe, int64_t{0});
    if (counts[observer.keyframe]++ == 0 && observer.keyframe != i) {
      rows.push_back(observer.keyframe);
    }
  });
  std::sort(rows.begin(), rows.end());
  for (const int64_t row : rows) {
    shared.push_back(counts[row]);
  }
  set_neighbors(i, rows.data(), shared.data(), static_cast<int>(rows.size()));
}

void ObservationGraph::set_neighbors(
  int64_t i, const int64_t* rows, const int64_t* shared, int count)
{
  grow(connections_, i);
  for (const auto& [other, _] : std::vector<Connection>(connections_[i])) {
    if (!std::binary_search(rows, rows + count, other)) {
      set_neighbor(other, i, 0);
    }
  }
  connections_[i].clear();
  for (int n = 0; n < count; ++n) {
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
    for (const Connection& connection : connections_[i]) {
      if (connection.second >= min_shared) {
        found.push_back(connection);
      }
    }
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
  const Poses& poses, int64_t start, int64_t goal, int64_t min_shared, double m_per_rad) const
{
  using Reached = std::pair<double, int64_t>;  // length of the path to a keyframe
  std::vector<std::vector<int64_t>> children(poses.count);
  for (int64_t i = 0; i < poses.count; ++i) {
    if (poses.parents[i] >= 0) {
      children[poses.parents[i]].push_back(i);
    }
  }
  std::vector<double> length(poses.count, std::numeric_limits<double>::infinity());
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
      const double reached = so_far + distance_m(poses, from, to, m_per_rad);
      if (reached < length[to]) {
        length[to] = reached;
        queue.emplace(reached, to);
      }
    };
    if (i < static_cast<int64_t>(connections_.size())) {
      for (const auto& [other, shared] : connections_[i]) {
        if (shared >= min_shared && other < poses.count) {
          reach(other);
        }
      }
    }
    std::for_each(children[i].begin(), children[i].end(), reach);
    if (poses.parents[i] >= 0) {
      reach(poses.parents[i]);
    }
  }
  return std::numeric_limits<double>::infinity();
}

std::vector<int64_t> ObservationGraph::count_observed(
  const int64_t* j, int count, const int64_t* keyframes, int num_keyframes) const
{
  const std::vector<int32_t> position = positions(keyframes, num_keyframes);
  std::vector<int64_t> counts(num_keyframes);
  visit(j, count, [&](const Observer& observer, int64_t) {
    if (const int32_t at = find(position, observer.keyframe); at != kNone) {
      ++counts[at];
    }
  });
  return counts;
}

std::vector<int64_t> ObservationGraph::points_of(
  const PointTable& table, const int64_t* keyframes, int num_keyframes)
{
  if (++search_ == 0) {  // the counter has overflowed
    std::fill(marks_.begin(), marks_.end(), 0);
    search_ = 1;
  }
  std::vector<int64_t> found;
  for (int n = 0; n < num_keyframes; ++n) {
    const int32_t* points = table.points + keyframes[n] * table.num_features;
    for (int k = 0; k < table.num_features; ++k) {
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
