// 16 lanes without any vector instruction: the meaning of every operation, and the way out on unknown machines.
#pragma once
#include "types.h"
#include <cstring>

namespace sgm {
namespace SGM_ISA {

struct Sum16 {
  u16 v[16];
  static Sum16 load(const u16* p) { Sum16 r; std::memcpy(r.v, p, 32); return r; }
  void store(u16* p) const { std::memcpy(p, v, 32); }
  static int at(int d) { return d; }  // where disparity d is stored
};
struct B {
  enum { N = 16 };
  using Sum = Sum16;
  u8 v[16];
  static B load(const u8* p) { B r; std::memcpy(r.v, p, 16); return r; }
  void store(u8* p) const { std::memcpy(p, v, 16); }
  void stream(u8* p) const { store(p); }
  static B set1(u8 a) { B r; std::memset(r.v, a, 16); return r; }
};
#define SGM_LANES(expr) B r; for (int i = 0; i < 16; ++i) r.v[i] = static_cast<u8>(expr); return r
static inline B vmin(B a, B b) { SGM_LANES(a.v[i] < b.v[i] ? a.v[i] : b.v[i]); }
static inline B band(B a, B b) { SGM_LANES(a.v[i] & b.v[i]); }
static inline B bxor(B a, B b) { SGM_LANES(a.v[i] ^ b.v[i]); }
static inline B add(B a, B b) { SGM_LANES(a.v[i] + b.v[i]); }
static inline B sub(B a, B b) { SGM_LANES(a.v[i] - b.v[i]); }
static inline B adds(B a, B b) { SGM_LANES(a.v[i] + b.v[i] > 255 ? 255 : a.v[i] + b.v[i]); }
static inline B absdiff(B a, B b) { SGM_LANES(a.v[i] > b.v[i] ? a.v[i] - b.v[i] : b.v[i] - a.v[i]); }
static inline B avg(B a, B b) { SGM_LANES((a.v[i] + b.v[i] + 1) >> 1); }
static inline B below_or_equal(B a, B b) { SGM_LANES(a.v[i] <= b.v[i] ? 255 : 0); }
static inline B steps(B a) { SGM_LANES((a.v[i] >> kStepShift) < 15 ? a.v[i] >> kStepShift : 15); }
static inline B lookup(B table, B index) { SGM_LANES(table.v[index.v[i]]); }
static inline B before(B a) { SGM_LANES(i == 0 ? 255 : a.v[i - 1]); }
static inline B after(B a) { SGM_LANES(i == 15 ? 255 : a.v[i + 1]); }
static inline B shifted(B a, int by) { SGM_LANES(i + by >= 0 && i + by < 16 ? a.v[i + by] : 0); }
// Lanes moved by one across neighbouring vectors.
static inline B before(B previous, B a) { SGM_LANES(i == 0 ? previous.v[15] : a.v[i - 1]); }
static inline B after(B a, B next) { SGM_LANES(i == 15 ? next.v[0] : a.v[i + 1]); }
static inline B bits(B a) {
  SGM_LANES((a.v[i] & 1) + (a.v[i] >> 1 & 1) + (a.v[i] >> 2 & 1) + (a.v[i] >> 3 & 1) + (a.v[i] >> 4 & 1) +
            (a.v[i] >> 5 & 1) + (a.v[i] >> 6 & 1) + (a.v[i] >> 7));
}
#undef SGM_LANES
static inline void stream_end() {}
static inline u8 hmin(B a) {
  u8 m = 255;
  for (int i = 0; i < 16; ++i) m = a.v[i] < m ? a.v[i] : m;
  return m;
}
static inline B hmin_all(B a) { return B::set1(hmin(a)); }
static inline B hamming(const u64* right, u64 left) {
  B r;
  for (int i = 0; i < 16; ++i) {
    u64 x = right[i] ^ left;
    x -= (x >> 1) & 0x5555555555555555ull;
    x = (x & 0x3333333333333333ull) + ((x >> 2) & 0x3333333333333333ull);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0full;
    r.v[i] = static_cast<u8>((x * 0x0101010101010101ull) >> 56);
  }
  return r;
}
static inline Sum16 pair_sum(B a, B b) {
  Sum16 r;
  for (int i = 0; i < 16; ++i) r.v[i] = static_cast<u16>(a.v[i] + b.v[i]);
  return r;
}
static inline Sum16 eightfold(B a) {
  Sum16 r;
  for (int i = 0; i < 16; ++i) r.v[i] = static_cast<u16>(8 * a.v[i]);
  return r;
}
static inline Sum16 add(Sum16 a, Sum16 b) {
  Sum16 r;
  for (int i = 0; i < 16; ++i) r.v[i] = static_cast<u16>(a.v[i] + b.v[i]);
  return r;
}
static inline u32 argmin(Sum16 a) {
  u32 best = 0xffffffffu;
  for (u32 i = 0; i < 16; ++i) {
    const u32 key = static_cast<u32>(a.v[i]) << 16 | i;
    best = key < best ? key : best;
  }
  return best;
}
static inline void interleave(const u8* planes, std::ptrdiff_t stride, u64* out) {
  for (int i = 0; i < 16; ++i) {
    u64 x = 0;
    for (int k = 0; k < 8; ++k) x |= static_cast<u64>(planes[k * stride + i]) << (8 * k);
    out[i] = x;
  }
}

#include "running.inl"
using V = B;
using W = B;
using Running = Running16;
using RunningW = Running16;

}  // namespace SGM_ISA
}  // namespace sgm
