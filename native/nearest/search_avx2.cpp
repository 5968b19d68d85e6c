// Two products of bytes and their sum a lane of 16 bits at once.
#include <immintrin.h>

#include "nearest.h"

#include <cstring>
#include <vector>

namespace nearest {
namespace avx2 {

struct V {
  using T = __m256i;
  using Number = u16;
  static constexpr int N = 16, VECTORS = 3, ROWS = 3, STEPS = LENGTH / 2;

  static T load(const void* p) { return _mm256_loadu_si256(static_cast<const T*>(p)); }
  static void store(void* p, T v) { _mm256_storeu_si256(static_cast<T*>(p), v); }
  static T all(i32 v) { return _mm256_set1_epi16(static_cast<short>(v)); }
  static T add(T a, T b) { return _mm256_add_epi16(a, b); }
  static T max(T a, T b) { return _mm256_max_epu16(a, b); }
  static T min(T a, T b) { return _mm256_min_epu16(a, b); }
  static T where_larger(T a, T b, T yes, T no) { return _mm256_blendv_epi8(yes, no, _mm256_cmpeq_epi16(max(a, b), b)); }

  // Four bytes of a row go to all lanes at once, which is cheaper than two. So the even lanes (columns) of a vector have
  // the first two of these four numbers, the odd ones the other two; the next step has them the other way round.
  static int number_of(int step, int column) { return step / 2 * 4 + 2 * ((step + column) % 2); }

  struct Packed {
    std::vector<u8> data;  // (vectors, STEPS, N, 2)

    Packed(const Descriptors& b, int columns) : data(static_cast<std::size_t>(columns) * LENGTH) {
      for (int c = 0; c < b.count; ++c) {
        const u8* from = b.data.data() + static_cast<std::size_t>(c) * LENGTH;
        u8* to = data.data() + static_cast<std::size_t>(c / N) * N * LENGTH + 2 * (c % N);
        for (int s = 0; s < STEPS; ++s) std::memcpy(to + s * 2 * N, from + number_of(s, c), 2);
      }
    }
  };

  struct Rows {
    i32 data[STEPS][ROWS];

    void take(const Descriptors& a, int first) {
      std::memset(data, 0, sizeof(data));
      for (int r = 0; r < ROWS && first + r < a.count; ++r) {
        const u8* row = a.data.data() + static_cast<std::size_t>(first + r) * LENGTH;
        for (int s = 0; s < STEPS; ++s) {
          u8 four[4];
          std::memcpy(four, row + number_of(s, 0), 2);
          std::memcpy(four + 2, row + number_of(s, 1), 2);
          std::memcpy(&data[s][r], four, 4);
        }
      }
    }
  };

  static void tile(const Rows& rows, const Packed& packed, int tile, T (&dots)[ROWS][VECTORS]) {
    const u8* columns = packed.data.data() + static_cast<std::size_t>(tile) * VECTORS * N * LENGTH;
    T sums[ROWS][VECTORS];
    for (auto& row : sums) row[0] = row[1] = row[2] = _mm256_setzero_si256();
#pragma GCC unroll 4
    for (int s = 0; s < STEPS; ++s) {
      T column[VECTORS];
      for (int v = 0; v < VECTORS; ++v) column[v] = load(columns + (v * STEPS + s) * 2 * N);
#pragma GCC unroll 3
      for (int r = 0; r < ROWS; ++r) {
        const T row = _mm256_set1_epi32(rows.data[s][r]);
#pragma GCC unroll 3
        for (int v = 0; v < VECTORS; ++v) sums[r][v] = add(sums[r][v], _mm256_maddubs_epi16(column[v], row));
      }
    }
    std::memcpy(dots, sums, sizeof(sums));
  }
};

}  // namespace avx2
}  // namespace nearest

#define NEAREST_ISA avx2
#include "search.inl"

namespace nearest {
extern const Kernel kernel_avx2;
const Kernel kernel_avx2 = {"avx2", avx2::search, 1 << 16};  // their numbers have 16 bits
}  // namespace nearest
