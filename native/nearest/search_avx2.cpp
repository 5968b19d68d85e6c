// Two products of 16 bits a lane at once.
#include <immintrin.h>

#include "nearest.h"

#include <cstring>
#include <vector>

namespace nearest {
namespace avx2 {

struct V {
  using T = __m256i;
  static constexpr int N = 8, VECTORS = 2, ROWS = 4, STEPS = LENGTH / 2;

  static T load(const i32* p) { return _mm256_loadu_si256(reinterpret_cast<const T*>(p)); }
  static void store(i32* p, T v) { _mm256_storeu_si256(reinterpret_cast<T*>(p), v); }
  static T all(i32 v) { return _mm256_set1_epi32(v); }
  static T add(T a, T b) { return _mm256_add_epi32(a, b); }
  static T max(T a, T b) { return _mm256_max_epi32(a, b); }
  static T min(T a, T b) { return _mm256_min_epi32(a, b); }
  static T where_larger(T a, T b, T yes, T no) { return _mm256_blendv_epi8(no, yes, _mm256_cmpgt_epi32(a, b)); }

  struct Packed {
    std::vector<std::int16_t> data;  // (vectors, STEPS, N, 2)

    Packed(const Descriptors& b, int columns) : data(static_cast<std::size_t>(columns) * LENGTH) {
      for (int c = 0; c < b.count; ++c) {
        const u8* from = b.data + static_cast<std::size_t>(c) * LENGTH;
        std::int16_t* to = data.data() + static_cast<std::size_t>(c / N) * N * LENGTH + 2 * (c % N);
        for (int k = 0; k < LENGTH; ++k) to[(k / 2) * 2 * N + k % 2] = from[k];
      }
    }
  };

  struct Rows {
    i32 data[STEPS][ROWS];  // two numbers of 16 bits each

    void take(const Descriptors& a, int first) {
      for (int r = 0; r < ROWS; ++r) {
        const u8* row = a.data + static_cast<std::size_t>(first + r) * LENGTH;
        for (int s = 0; s < STEPS; ++s) data[s][r] = first + r < a.count ? row[2 * s] | row[2 * s + 1] << 16 : 0;
      }
    }
  };

  static void tile(const Rows& rows, const Packed& packed, int tile, T (&dots)[ROWS][VECTORS]) {
    const std::int16_t* columns = packed.data.data() + static_cast<std::size_t>(tile) * VECTORS * N * LENGTH;
    T sums[ROWS][VECTORS];
    for (auto& row : sums) row[0] = row[1] = _mm256_setzero_si256();
    for (int s = 0; s < STEPS; ++s) {
      const T one = load(reinterpret_cast<const i32*>(columns + s * 2 * N));
      const T other = load(reinterpret_cast<const i32*>(columns + N * LENGTH + s * 2 * N));
#pragma GCC unroll 4
      for (int r = 0; r < ROWS; ++r) {
        const T row = all(rows.data[s][r]);
        sums[r][0] = add(sums[r][0], _mm256_madd_epi16(one, row));
        sums[r][1] = add(sums[r][1], _mm256_madd_epi16(other, row));
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
const Kernel kernel_avx2 = {"avx2", avx2::search};
}  // namespace nearest
