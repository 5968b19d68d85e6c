// Without intrinsics: what the compiler makes of it (on ARM: NEON's multiply and add).
#include "nearest.h"

#include <climits>
#include <cstring>
#include <vector>

namespace nearest {
namespace plain {

struct V {
  using Number = i32;
  static constexpr int N = 8, VECTORS = 1, ROWS = 4;
  struct T {
    i32 v[N];
  };

  static T load(const i32* p) {
    T out;
    std::memcpy(out.v, p, sizeof(out.v));
    return out;
  }
  static void store(i32* p, const T& a) { std::memcpy(p, a.v, sizeof(a.v)); }
  template <class F>
  static T each(F f) {
    T out;
    for (int k = 0; k < N; ++k) out.v[k] = f(k);
    return out;
  }
  static T all(i32 value) {
    return each([&](int) { return value; });
  }
  static T add(const T& a, const T& b) {
    return each([&](int k) { return a.v[k] + b.v[k]; });
  }
  static T max(const T& a, const T& b) {
    return each([&](int k) { return a.v[k] > b.v[k] ? a.v[k] : b.v[k]; });
  }
  static T min(const T& a, const T& b) {
    return each([&](int k) { return a.v[k] < b.v[k] ? a.v[k] : b.v[k]; });
  }
  static T where_larger(const T& a, const T& b, const T& yes, const T& no) {
    return each([&](int k) { return a.v[k] > b.v[k] ? yes.v[k] : no.v[k]; });
  }

  struct Packed {
    std::vector<std::int16_t> data;  // (vectors, LENGTH, N)

    Packed(const Descriptors& b, int columns) : data(static_cast<std::size_t>(columns) * LENGTH) {
      for (int c = 0; c < b.count; ++c) {
        std::int16_t* to = data.data() + static_cast<std::size_t>(c / N) * N * LENGTH + c % N;
        for (int k = 0; k < LENGTH; ++k) to[k * N] = b.data[static_cast<std::size_t>(c) * LENGTH + k];
      }
    }
  };

  struct Rows {
    std::int16_t data[LENGTH][ROWS];

    void take(const Descriptors& a, int first) {
      std::memset(data, 0, sizeof(data));
      for (int r = 0; r < ROWS && first + r < a.count; ++r) {
        const u8* row = a.data.data() + static_cast<std::size_t>(first + r) * LENGTH;
        for (int k = 0; k < LENGTH; ++k) data[k][r] = row[k];
      }
    }
  };

  static void tile(const Rows& rows, const Packed& packed, int tile, T (&dots)[ROWS][VECTORS]) {
    const std::int16_t* columns = packed.data.data() + static_cast<std::size_t>(tile) * N * LENGTH;
    i32 sums[ROWS][N] = {};
    for (int k = 0; k < LENGTH; ++k) {
      for (int r = 0; r < ROWS; ++r) {
        for (int c = 0; c < N; ++c) sums[r][c] += static_cast<i32>(rows.data[k][r]) * columns[k * N + c];
      }
    }
    for (int r = 0; r < ROWS; ++r) dots[r][0] = load(sums[r]);
  }
};

}  // namespace plain
}  // namespace nearest

#define NEAREST_ISA plain
#include "search.inl"

namespace nearest {
extern const Kernel kernel_plain;
const Kernel kernel_plain = {"plain", plain::search, INT_MAX};
}  // namespace nearest
