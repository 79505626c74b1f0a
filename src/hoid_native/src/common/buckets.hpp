#pragma once

#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace hoid {

// Items sorted by a small key (counting sort; equal keys keep their order): those with key k are
// order[start[k]] to order[start[k + 1] - 1].
struct Buckets
{
  std::vector<int32_t> start, order;
};

// Sort items (numbers) by key(item), which is in [0, num_keys).
template <typename Items, typename Key>
Buckets sort_into_buckets(const Items& items, std::size_t num_keys, Key key)
{
  Buckets out{std::vector<int32_t>(num_keys + 1), std::vector<int32_t>(items.size())};
  for (const int32_t item : items) {
    ++out.start[key(item) + 1];
  }
  std::partial_sum(out.start.begin(), out.start.end(), out.start.begin());
  std::vector<int32_t> next = out.start;
  for (const int32_t item : items) {
    out.order[next[key(item)]++] = item;
  }
  return out;
}

}  // namespace hoid
