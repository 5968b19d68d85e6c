// 16 lanes of 64-bit ARM, where NEON is always there.
#pragma once
#include "types.h"
#include <arm_neon.h>

namespace sgm {
namespace SGM_ISA {

struct Sum16 {
  uint16x8_t a, b;
  static Sum16 load(const u16* p) { return {vld1q_u16(p), vld1q_u16(p + 8)}; }
  void store(u16* p) const {
    vst1q_u16(p, a);
    vst1q_u16(p + 8, b);
  }
  static int at(int d) { return d; }  // where disparity d is stored
};
struct B {
  enum { N = 16 };
  using Sum = Sum16;
  uint8x16_t v;
  static B load(const u8* p) { return {vld1q_u8(p)}; }
  void store(u8* p) const { vst1q_u8(p, v); }
  void stream(u8* p) const { store(p); }
  static B set1(u8 a) { return {vdupq_n_u8(a)}; }
};
static inline B vmin(B a, B b) { return {vminq_u8(a.v, b.v)}; }
static inline B band(B a, B b) { return {vandq_u8(a.v, b.v)}; }
static inline B bxor(B a, B b) { return {veorq_u8(a.v, b.v)}; }
static inline B bits(B a) { return {vcntq_u8(a.v)}; }
static inline void stream_end() {}
static inline B add(B a, B b) { return {vaddq_u8(a.v, b.v)}; }
static inline B sub(B a, B b) { return {vsubq_u8(a.v, b.v)}; }
static inline B adds(B a, B b) { return {vqaddq_u8(a.v, b.v)}; }
static inline B absdiff(B a, B b) { return {vabdq_u8(a.v, b.v)}; }
static inline B avg(B a, B b) { return {vrhaddq_u8(a.v, b.v)}; }
static inline B below_or_equal(B a, B b) { return {vcleq_u8(a.v, b.v)}; }
static inline B steps(B a) { return {vminq_u8(vshrq_n_u8(a.v, kStepShift), vdupq_n_u8(15))}; }
static inline B lookup(B table, B index) { return {vqtbl1q_u8(table.v, index.v)}; }
static inline B before(B a) { return {vextq_u8(vdupq_n_u8(255), a.v, 15)}; }
static inline B after(B a) { return {vextq_u8(a.v, vdupq_n_u8(255), 1)}; }
static inline B before(B previous, B a) { return {vextq_u8(previous.v, a.v, 15)}; }
static inline B after(B a, B next) { return {vextq_u8(a.v, next.v, 1)}; }
static inline B shifted(B a, int by) {
  alignas(16) static const u8 kLane[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  // A lane beyond 0..15 reads zero: below it wraps to 240 and more, if it is held where a byte can tell.
  const int held = by < -16 ? -16 : by > 16 ? 16 : by;
  return {vqtbl1q_u8(a.v, vaddq_u8(vld1q_u8(kLane), vdupq_n_u8(static_cast<u8>(held))))};
}
static inline u8 hmin(B a) { return vminvq_u8(a.v); }
static inline B hmin_all(B a) { return {vdupq_n_u8(vminvq_u8(a.v))}; }

static inline B hamming(const u64* right, u64 left) {
  const uint64x2_t c = vdupq_n_u64(left);
  uint8x16_t n[8];  // set bits of each byte; halves of neighbours are added until a byte is left of each place
  for (int k = 0; k < 8; ++k) n[k] = vcntq_u8(vreinterpretq_u8_u64(veorq_u64(vld1q_u64(right + 2 * k), c)));
  for (int left_over = 4; left_over > 0; left_over /= 2) {
    for (int k = 0; k < left_over; ++k) n[k] = vpaddq_u8(n[2 * k], n[2 * k + 1]);
  }
  return {n[0]};
}

static inline Sum16 pair_sum(B a, B b) {
  return {vaddl_u8(vget_low_u8(a.v), vget_low_u8(b.v)), vaddl_high_u8(a.v, b.v)};
}
static inline Sum16 eightfold(B a) { return {vshll_n_u8(vget_low_u8(a.v), 3), vshll_high_n_u8(a.v, 3)}; }
static inline Sum16 add(Sum16 a, Sum16 b) { return {vaddq_u16(a.a, b.a), vaddq_u16(a.b, b.b)}; }
static inline u32 argmin(Sum16 a) {
  alignas(16) static const u16 kPlace[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  const u16 least = vminvq_u16(vminq_u16(a.a, a.b));
  const uint16x8_t l = vdupq_n_u16(least), none = vdupq_n_u16(0xffff);
  const uint16x8_t p = vbslq_u16(vceqq_u16(a.a, l), vld1q_u16(kPlace), none);
  const uint16x8_t q = vbslq_u16(vceqq_u16(a.b, l), vld1q_u16(kPlace + 8), none);
  return static_cast<u32>(least) << 16 | vminvq_u16(vminq_u16(p, q));
}
static inline void interleave(const u8* planes, std::ptrdiff_t stride, u64* out) {
  uint8x16_t p[8];
  uint16x8_t q[8];
  for (int k = 0; k < 8; ++k) p[k] = vld1q_u8(planes + k * stride);
  for (int k = 0; k < 4; ++k) {
    q[k] = vreinterpretq_u16_u8(vzip1q_u8(p[2 * k], p[2 * k + 1]));      // pixels 0..7, planes 2k 2k+1
    q[k + 4] = vreinterpretq_u16_u8(vzip2q_u8(p[2 * k], p[2 * k + 1]));  // pixels 8..15
  }
  for (int h = 0; h < 2; ++h) {
    const uint32x4_t r[4] = {
        vreinterpretq_u32_u16(vzip1q_u16(q[4 * h], q[4 * h + 1])),
        vreinterpretq_u32_u16(vzip2q_u16(q[4 * h], q[4 * h + 1])),
        vreinterpretq_u32_u16(vzip1q_u16(q[4 * h + 2], q[4 * h + 3])),
        vreinterpretq_u32_u16(vzip2q_u16(q[4 * h + 2], q[4 * h + 3])),
    };
    for (int g = 0; g < 2; ++g) {
      u64* o = out + 8 * h + 4 * g;
      vst1q_u64(o, vreinterpretq_u64_u32(vzip1q_u32(r[g], r[g + 2])));
      vst1q_u64(o + 2, vreinterpretq_u64_u32(vzip2q_u32(r[g], r[g + 2])));
    }
  }
}

#include "running.inl"
using V = B;
using W = B;
using Running = Running16;
using RunningW = Running16;

}  // namespace SGM_ISA
}  // namespace sgm
