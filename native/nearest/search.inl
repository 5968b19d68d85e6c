// The search over a set of instructions V: tiles of ROWS descriptors of one image by V::COLUMNS of the other.
//
// V::Packed packs descriptors of the second image for its columns; V::tile computes the dot products of a tile and leaves
// them in (ROWS, V::COLUMNS) vectors of V::N numbers V::Number; the rest is maxima.
#include "nearest.h"

#include <algorithm>
#include <vector>

namespace nearest {
namespace NEAREST_ISA {

// What is known of the V::N columns of a vector: the largest and second largest so far, and where the largest was.
struct Best {
  alignas(64) typename V::Number best[V::N] = {}, second[V::N] = {}, index[V::N] = {};
};

struct Lanes {
  typename V::T best, second, index;

  explicit Lanes(const Best& from) : best(V::load(from.best)), second(V::load(from.second)), index(V::load(from.index)) {}

  void take(typename V::T dot, typename V::T where) {
    second = V::max(second, V::min(best, dot));
    index = V::where_larger(dot, best, where, index);
    best = V::max(best, dot);
  }

  void store(Best& to) const { V::store(to.best, best), V::store(to.second, second), V::store(to.index, index); }
};

inline void write(const Found& found, int at, i32 index, i32 best, i32 second) {
  found.index[at] = best > 0 ? index : -1;
  found.best[at] = best;
  found.second[at] = second;
}

// The best of all lanes: each has seen a part of the other image.
inline void write_row(const Found& found, int at, const Best& lanes) {
  int winner = 0;
  for (int k = 1; k < V::N; ++k) {
    const bool more = lanes.best[k] > lanes.best[winner];
    const bool before = lanes.best[k] == lanes.best[winner] && lanes.index[k] < lanes.index[winner];
    if (more || before) winner = k;
  }
  i32 second = lanes.second[winner];
  for (int k = 0; k < V::N; ++k) {
    if (k != winner) second = std::max<i32>(second, lanes.best[k]);
  }
  write(found, at, lanes.index[winner], lanes.best[winner], second);
}

void search(const Descriptors& a, const Descriptors& b, const Found& of_a, const Found& of_b) {
  using T = typename V::T;
  using Number = typename V::Number;
  constexpr int VECTORS = V::VECTORS, COLUMNS = VECTORS * V::N, ROWS = V::ROWS;
  constexpr int BLOCK = 1024 / COLUMNS;  // tiles that all rows go over before the next: they stay in the cache
  const int tiles = (b.count + COLUMNS - 1) / COLUMNS;
  const typename V::Packed packed(b, tiles * COLUMNS);
  std::vector<Best> columns(static_cast<std::size_t>(tiles) * VECTORS), of_rows(a.count + ROWS);
  Number numbers[V::N];
  for (int k = 0; k < V::N; ++k) numbers[k] = static_cast<Number>(k);
  const T lanes = V::load(numbers);
  typename V::Rows rows;
  for (int block = 0; block < tiles; block += BLOCK) {
    for (int first = 0; first < a.count; first += ROWS) {
      rows.take(a, first);
      Best* const own = &of_rows[first];
      for (int tile = block; tile < std::min(tiles, block + BLOCK); ++tile) {
        T dots[ROWS][VECTORS];
        V::tile(rows, packed, tile, dots);
        for (int r = 0; r < ROWS; ++r) {
          Lanes row(own[r]);
          for (int v = 0; v < VECTORS; ++v) row.take(dots[r][v], V::add(lanes, V::all(tile * COLUMNS + v * V::N)));
          row.store(own[r]);
        }
        for (int v = 0; v < VECTORS; ++v) {
          Best& best = columns[static_cast<std::size_t>(tile) * VECTORS + v];
          Lanes column(best);
          for (int r = 0; r < ROWS; ++r) column.take(dots[r][v], V::all(first + r));
          column.store(best);
        }
      }
    }
  }
  for (int r = 0; r < a.count; ++r) write_row(of_a, r, of_rows[r]);
  for (int k = 0; k < b.count; ++k) {
    const Best& column = columns[k / V::N];
    write(of_b, k, column.index[k % V::N], column.best[k % V::N], column.second[k % V::N]);
  }
}

}  // namespace NEAREST_ISA
}  // namespace nearest
