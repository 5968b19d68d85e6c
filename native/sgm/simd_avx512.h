// 64 lanes of AVX-512 for the dense form.
#pragma once
#include "simd_avx2.h"

namespace sgm {
namespace SGM_ISA {

// Sums in the order in which bytes are unpacked: the lower eight of each sixteen, then the upper ones.
struct Sum64 {
  __m512i a, b;
  static int at(int d) { return (d & ~63) | (d & 8) << 2 | (d & 48) >> 1 | (d & 7); }  // where disparity d is stored
  void store(u16* p) const {
    _mm512_storeu_si512(p, a);
    _mm512_storeu_si512(p + 32, b);
  }
};
struct V64 {
  enum { N = 64 };
  using Sum = Sum64;
  __m512i v;
  static V64 load(const u8* p) { return {_mm512_loadu_si512(p)}; }
  void store(u8* p) const { _mm512_storeu_si512(p, v); }
  void stream(u8* p) const { _mm512_stream_si512(reinterpret_cast<__m512i*>(p), v); }
  static V64 set1(u8 a) { return {_mm512_set1_epi8(static_cast<char>(a))}; }
};
static inline V64 vmin(V64 a, V64 b) { return {_mm512_min_epu8(a.v, b.v)}; }
static inline V64 bxor(V64 a, V64 b) { return {_mm512_xor_si512(a.v, b.v)}; }
static inline V64 bits(V64 a) { return {_mm512_popcnt_epi8(a.v)}; }
static inline V64 add(V64 a, V64 b) { return {_mm512_add_epi8(a.v, b.v)}; }
static inline V64 sub(V64 a, V64 b) { return {_mm512_sub_epi8(a.v, b.v)}; }
static inline V64 adds(V64 a, V64 b) { return {_mm512_adds_epu8(a.v, b.v)}; }
static inline V64 avg(V64 a, V64 b) { return {_mm512_avg_epu8(a.v, b.v)}; }
static inline V64 with_bit(V64 plane, V64 a, V64 centre, int bit) {
  const __m512i one = _mm512_set1_epi8(static_cast<char>(1 << bit));
  return {_mm512_mask_add_epi8(plane.v, _mm512_cmple_epu8_mask(a.v, centre.v), plane.v, one)};
}
static inline u8 hmin(V64 a) {
  return hmin(V32{_mm256_min_epu8(_mm512_castsi512_si256(a.v), _mm512_extracti64x4_epi64(a.v, 1))});
}
// Least of each of four vectors: halves, quarters and so on of all four at once.
static inline void least_of_four(const V64* low, u8* least) {
  const __m512i a = low[0].v, b = low[1].v, c = low[2].v, d = low[3].v;
  const __m512i p = _mm512_min_epu8(_mm512_shuffle_i64x2(a, b, 0x44), _mm512_shuffle_i64x2(a, b, 0xee));
  const __m512i q = _mm512_min_epu8(_mm512_shuffle_i64x2(c, d, 0x44), _mm512_shuffle_i64x2(c, d, 0xee));
  __m512i r = _mm512_min_epu8(_mm512_shuffle_i64x2(p, q, 0x88), _mm512_shuffle_i64x2(p, q, 0xdd));
  r = _mm512_min_epu8(r, _mm512_bsrli_epi128(r, 8));
  r = _mm512_min_epu8(r, _mm512_bsrli_epi128(r, 4));
  r = _mm512_min_epu8(r, _mm512_bsrli_epi128(r, 2));
  r = _mm512_min_epu8(r, _mm512_bsrli_epi128(r, 1));
  const __m512i lanes = _mm512_castsi128_si512(_mm_setr_epi32(0, 4, 8, 12));
  const __m128i words = _mm512_castsi512_si128(_mm512_permutexvar_epi32(lanes, r));
  const int four = _mm_cvtsi128_si32(_mm_cvtepi32_epi8(words));
  std::memcpy(least, &four, 4);
}
static inline Sum64 pair_sum(V64 a, V64 b) {
  const __m512i one = _mm512_set1_epi8(1);
  return {_mm512_maddubs_epi16(_mm512_unpacklo_epi8(a.v, b.v), one),
          _mm512_maddubs_epi16(_mm512_unpackhi_epi8(a.v, b.v), one)};
}
static inline Sum64 forward_sum(V64 cost, V64 half) {
  const __m512i times = _mm512_set1_epi16(0x0208);
  return {_mm512_maddubs_epi16(_mm512_unpacklo_epi8(cost.v, half.v), times),
          _mm512_maddubs_epi16(_mm512_unpackhi_epi8(cost.v, half.v), times)};
}
static inline Sum64 add(Sum64 a, Sum64 b) { return {_mm512_add_epi16(a.a, b.a), _mm512_add_epi16(a.b, b.b)}; }

struct Running64 {
  __m512i best = _mm512_set1_epi16(-1), place = _mm512_setzero_si512();
  void half(__m512i t, int at) {
    const __mmask32 less = _mm512_cmplt_epu16_mask(t, best);
    place = _mm512_mask_mov_epi16(place, less, _mm512_set1_epi16(static_cast<short>(at)));
    best = _mm512_min_epu16(t, best);
  }
  void see(Sum64 t, int at) {
    half(t.a, at);
    half(t.b, at + 8);
  }
  static u32 least_of(__m512i a) {
    const __m256i h = _mm256_min_epu16(_mm512_castsi512_si256(a), _mm512_extracti64x4_epi64(a, 1));
    const __m128i q = _mm_min_epu16(_mm256_castsi256_si128(h), _mm256_extracti128_si256(h, 1));
    return static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(q))) & 0xffff;
  }
  u32 result() const {
    alignas(64) static const u16 lanes[32] = {0,  1,  2,  3,  4,  5,  6,  7,  16, 17, 18, 19, 20, 21, 22, 23,
                                              32, 33, 34, 35, 36, 37, 38, 39, 48, 49, 50, 51, 52, 53, 54, 55};
    const u32 least = least_of(best);
    const __mmask32 is = _mm512_cmpeq_epi16_mask(best, _mm512_set1_epi16(static_cast<short>(least)));
    const __m512i at = _mm512_add_epi16(place, _mm512_load_si512(lanes));
    return least << 16 | least_of(_mm512_mask_blend_epi16(is, _mm512_set1_epi16(-1), at));
  }
};
static inline __mmask64 first_lanes(int n) { return _bzhi_u64(~0ull, n < 0 ? 0u : n > 64 ? 64u : static_cast<u32>(n)); }
// The first n lanes, whole blocks of 16: stores under a mask would be slow, and loads after them wait.
static inline void store_first(V64 a, u8* p, int n) {
  if (n >= 64) return a.store(p);
  const __m256i upper = _mm512_extracti64x4_epi64(a.v, 1);
  if (n >= 32) _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), _mm512_castsi512_si256(a.v));
  if (n == 48) _mm_storeu_si128(reinterpret_cast<__m128i*>(p + 32), _mm256_castsi256_si128(upper));
  if (n == 16) _mm_storeu_si128(reinterpret_cast<__m128i*>(p), _mm512_castsi512_si128(a.v));
}

// Costs of 256 grey values, in registers.
struct Greys {
  __m512i a, b, c, d;
  static Greys load(const u8* p) {
    return {_mm512_loadu_si512(p), _mm512_loadu_si512(p + 64), _mm512_loadu_si512(p + 128),
            _mm512_loadu_si512(p + 192)};
  }
  __m512i of(__m512i grey) const {
    const __m512i dark = _mm512_permutex2var_epi8(a, grey, b), bright = _mm512_permutex2var_epi8(c, grey, d);
    return _mm512_mask_blend_epi8(_mm512_movepi8_mask(grey), dark, bright);
  }
};
static inline V64 told_by_greys(V64 cost, const Greys& table, const u8* right, bool mean) {
  const V64 said = {table.of(_mm512_loadu_si512(right))};
  return mean ? avg(cost, said) : said;
}
static inline B told_by_greys(B cost, const Greys& table, const u8* right, bool mean) {
  const B said = {_mm512_castsi512_si128(table.of(_mm512_castsi128_si512(B::load(right).v)))};
  return mean ? avg(cost, said) : said;
}

// Long ranges.
static inline V64 load_first(const u8* p, int n, V64 rest) {
  return {_mm512_mask_loadu_epi8(rest.v, first_lanes(n), p)};
}
static inline V64 told(const u8* source, int at, int length, V64 outside) {
  return {_mm512_mask_loadu_epi8(outside.v, first_lanes(length - at) & ~first_lanes(-at), source + at)};
}
// Lanes moved by one across neighbouring vectors.
static inline __m512i lanes_from(int first) {
  alignas(64) static const u8 kLane[64] = {
      0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21,
      22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43,
      44, 45, 46, 47, 48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61, 62, 63};
  return _mm512_add_epi8(_mm512_load_si512(kLane), _mm512_set1_epi8(static_cast<char>(first)));
}
static inline V64 before(V64 previous, V64 a) { return {_mm512_permutex2var_epi8(previous.v, lanes_from(63), a.v)}; }
static inline V64 after(V64 a, V64 next) { return {_mm512_permutex2var_epi8(a.v, lanes_from(1), next.v)}; }
using V = V64;
using W = V64;
using RunningW = Running64;
using Running = Running64;

}  // namespace SGM_ISA
}  // namespace sgm
