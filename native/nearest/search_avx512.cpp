// Four products and their sum a lane of 32 bits at once (VNNI).
#include <immintrin.h>

#include "nearest.h"

#include <climits>
#include <cstring>
#include <vector>

namespace nearest {
namespace avx512 {

struct V {
  using T = __m512i;
  using Number = i32;
  static constexpr int N = 16, VECTORS = 2, ROWS = 8, STEPS = LENGTH / 4;

  static T load(const i32* p) { return _mm512_loadu_si512(p); }
  static void store(i32* p, T v) { _mm512_storeu_si512(p, v); }
  static T all(i32 v) { return _mm512_set1_epi32(v); }
  static T add(T a, T b) { return _mm512_add_epi32(a, b); }
  static T max(T a, T b) { return _mm512_max_epi32(a, b); }
  static T min(T a, T b) { return _mm512_min_epi32(a, b); }
  static T where_larger(T a, T b, T yes, T no) { return _mm512_mask_mov_epi32(no, _mm512_cmpgt_epi32_mask(a, b), yes); }

  struct Packed {
    std::vector<u8> data;  // (vectors, STEPS, N, 4)

    Packed(const Descriptors& b, int columns) : data(static_cast<std::size_t>(columns) * LENGTH) {
      for (int c = 0; c < b.count; ++c) {
        const u8* from = b.data.data() + static_cast<std::size_t>(c) * LENGTH;
        u8* to = data.data() + static_cast<std::size_t>(c / N) * N * LENGTH + 4 * (c % N);
        for (int s = 0; s < STEPS; ++s) std::memcpy(to + s * 4 * N, from + 4 * s, 4);
      }
    }
  };

  struct Rows {
    alignas(64) i32 data[STEPS][ROWS];  // four bytes each

    void take(const Descriptors& a, int first) {
      std::memset(data, 0, sizeof(data));
      for (int r = 0; r < ROWS && first + r < a.count; ++r) {
        const u8* row = a.data.data() + static_cast<std::size_t>(first + r) * LENGTH;
        for (int s = 0; s < STEPS; ++s) std::memcpy(&data[s][r], row + 4 * s, 4);
      }
    }
  };

  static void tile(const Rows& rows, const Packed& packed, int tile, T (&dots)[ROWS][VECTORS]) {
    const u8* columns = packed.data.data() + static_cast<std::size_t>(tile) * VECTORS * N * LENGTH;
    T sums[ROWS][VECTORS];
    for (auto& row : sums) row[0] = row[1] = _mm512_setzero_si512();
    for (int s = 0; s < STEPS; ++s) {
      const T one = _mm512_loadu_si512(columns + s * 4 * N), other = _mm512_loadu_si512(columns + N * LENGTH + s * 4 * N);
#pragma GCC unroll 8
      for (int r = 0; r < ROWS; ++r) {
        const T row = all(rows.data[s][r]);
        sums[r][0] = _mm512_dpbusd_epi32(sums[r][0], one, row);
        sums[r][1] = _mm512_dpbusd_epi32(sums[r][1], other, row);
      }
    }
    std::memcpy(dots, sums, sizeof(sums));
  }
};

}  // namespace avx512
}  // namespace nearest

#define NEAREST_ISA avx512
#include "search.inl"

namespace nearest {
extern const Kernel kernel_avx512;
const Kernel kernel_avx512 = {"avx512vnni", avx512::search, INT_MAX};
}  // namespace nearest
