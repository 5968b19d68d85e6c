// The search over a set of instructions V: tiles of ROWS descriptors of one image by V::COLUMNS of the other.
//
// V::Packed packs descriptors of the second image for its columns; V::tile computes the dot products of a tile and leaves
// them in (ROWS, V::COLUMNS) vectors; the rest is maxima.
#include "nearest.h"

#include <algorithm>
#include <vector>

namespace nearest {
namespace NEAREST_ISA {

// What is known of the V::N columns of a vector: the largest and second largest so far, and where the largest was.
struct Best {
  alignas(64) i32 best[V::N], second[V::N], index[V::N];
};

inline void take(typename V::T dot, typename V::T where, typename V::T& best, typename V::T& second,
                 typename V::T& index) {
  second = V::max(second, V::min(best, dot));
  index = V::where_larger(dot, best, where, index);
  best = V::max(best, dot);
}

inline void write(const Found& found, int at, const Best& lanes) {
  int winner = 0;
  for (int k = 1; k < V::N; ++k) {
    const bool more = lanes.best[k] > lanes.best[winner];
    const bool before = lanes.best[k] == lanes.best[winner] && lanes.index[k] < lanes.index[winner];
    if (more || (before && lanes.best[k] > 0)) winner = k;
  }
  i32 second = lanes.second[winner];
  for (int k = 0; k < V::N; ++k) {
    if (k != winner) second = std::max(second, lanes.best[k]);
  }
  found.index[at] = lanes.index[winner];
  found.best[at] = lanes.best[winner];
  found.second[at] = second;
}

void search(const Descriptors& a, const Descriptors& b, const Found& of_a, const Found& of_b) {
  using T = typename V::T;
  constexpr int VECTORS = V::VECTORS, COLUMNS = VECTORS * V::N, ROWS = V::ROWS;
  const int tiles = (b.count + COLUMNS - 1) / COLUMNS;
  const typename V::Packed packed(b, tiles * COLUMNS);
  const Best none = [] {
    Best out;
    std::fill(out.best, out.best + V::N, 0);
    std::fill(out.second, out.second + V::N, 0);
    std::fill(out.index, out.index + V::N, -1);
    return out;
  }();
  std::vector<Best> columns(static_cast<std::size_t>(tiles) * VECTORS, none);
  i32 numbers[V::N];
  for (int k = 0; k < V::N; ++k) numbers[k] = k;
  const T lanes = V::load(numbers);
  typename V::Rows rows;
  for (int first = 0; first < a.count; first += ROWS) {
    rows.take(a, first);
    Best own[ROWS];
    std::fill(own, own + ROWS, none);
    for (int tile = 0; tile < tiles; ++tile) {
      T dots[ROWS][VECTORS];
      V::tile(rows, packed, tile, dots);
      for (int v = 0; v < VECTORS; ++v) {
        Best& column = columns[static_cast<std::size_t>(tile) * VECTORS + v];
        T best = V::load(column.best), second = V::load(column.second), index = V::load(column.index);
        const T number = V::add(lanes, V::all(tile * COLUMNS + v * V::N));
        for (int r = 0; r < ROWS; ++r) {
          take(dots[r][v], V::all(first + r), best, second, index);
          T row_best = V::load(own[r].best), row_second = V::load(own[r].second), row_index = V::load(own[r].index);
          take(dots[r][v], number, row_best, row_second, row_index);
          V::store(own[r].best, row_best), V::store(own[r].second, row_second), V::store(own[r].index, row_index);
        }
        V::store(column.best, best), V::store(column.second, second), V::store(column.index, index);
      }
    }
    for (int r = 0; r < ROWS && first + r < a.count; ++r) write(of_a, first + r, own[r]);
  }
  for (int k = 0; k < b.count; ++k) {
    const Best& column = columns[k / V::N];
    of_b.index[k] = column.index[k % V::N];
    of_b.best[k] = column.best[k % V::N];
    of_b.second[k] = column.second[k % V::N];
  }
}

}  // namespace NEAREST_ISA
}  // namespace nearest
