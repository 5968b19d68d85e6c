// 32 lanes of AVX2 for the dense form.
#pragma once
#include "simd_x86.h"

namespace sgm {
namespace SGM_ISA {

struct Sum32 {
  __m256i a, b;
  static Sum32 load(const u16* p) {
    return {_mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)),
            _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p + 16))};
  }
  void store(u16* p) const {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), a);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(p + 16), b);
  }
  static int at(int d) { return d; }  // where disparity d is stored
};
struct V32 {
  enum { N = 32 };
  using Sum = Sum32;
  __m256i v;
  static V32 load(const u8* p) { return {_mm256_loadu_si256(reinterpret_cast<const __m256i*>(p))}; }
  void store(u8* p) const { _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), v); }
  void stream(u8* p) const { _mm256_stream_si256(reinterpret_cast<__m256i*>(p), v); }
  static V32 set1(u8 a) { return {_mm256_set1_epi8(static_cast<char>(a))}; }
};
static inline V32 vmin(V32 a, V32 b) { return {_mm256_min_epu8(a.v, b.v)}; }
static inline V32 band(V32 a, V32 b) { return {_mm256_and_si256(a.v, b.v)}; }
static inline V32 bxor(V32 a, V32 b) { return {_mm256_xor_si256(a.v, b.v)}; }
static inline V32 bits(V32 a) {
#if defined(__AVX512BITALG__)
  return {_mm256_popcnt_epi8(a.v)};
#else
  const __m256i lut = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4));
  const __m256i low = _mm256_set1_epi8(15);
  return {_mm256_add_epi8(_mm256_shuffle_epi8(lut, _mm256_and_si256(a.v, low)),
                          _mm256_shuffle_epi8(lut, _mm256_and_si256(_mm256_srli_epi16(a.v, 4), low)))};
#endif
}
static inline V32 add(V32 a, V32 b) { return {_mm256_add_epi8(a.v, b.v)}; }
static inline V32 sub(V32 a, V32 b) { return {_mm256_sub_epi8(a.v, b.v)}; }
static inline V32 adds(V32 a, V32 b) { return {_mm256_adds_epu8(a.v, b.v)}; }
static inline V32 avg(V32 a, V32 b) { return {_mm256_avg_epu8(a.v, b.v)}; }
static inline V32 below_or_equal(V32 a, V32 b) { return {_mm256_cmpeq_epi8(_mm256_min_epu8(a.v, b.v), a.v)}; }
static inline u8 hmin(V32 a) {
  return hmin(B{_mm_min_epu8(_mm256_castsi256_si128(a.v), _mm256_extracti128_si256(a.v, 1))});
}
static inline V32 join(B a, B b) { return {_mm256_inserti128_si256(_mm256_castsi128_si256(a.v), b.v, 1)}; }
// Lanes 0-7, 16-23, 8-15, 24-31: unpacking in halves then gives the natural order.
static inline __m256i halves(__m256i a) { return _mm256_permute4x64_epi64(a, 0xd8); }
static inline Sum32 pair_sum(V32 a, V32 b) {
  const __m256i one = _mm256_set1_epi8(1), p = halves(a.v), q = halves(b.v);
  return {_mm256_maddubs_epi16(_mm256_unpacklo_epi8(p, q), one), _mm256_maddubs_epi16(_mm256_unpackhi_epi8(p, q), one)};
}
static inline Sum32 eightfold(V32 a) {
  const __m256i zero = _mm256_setzero_si256(), p = halves(a.v);
  return {_mm256_slli_epi16(_mm256_unpacklo_epi8(p, zero), 3), _mm256_slli_epi16(_mm256_unpackhi_epi8(p, zero), 3)};
}
static inline Sum32 add(Sum32 a, Sum32 b) { return {_mm256_add_epi16(a.a, b.a), _mm256_add_epi16(a.b, b.b)}; }

struct Running32 {
  __m256i best = _mm256_set1_epi16(-1), place = _mm256_setzero_si256();
  void half(__m256i t, int at) {
    const __m256i m = _mm256_min_epu16(t, best), old = _mm256_cmpeq_epi16(m, best);
    place = _mm256_blendv_epi8(_mm256_set1_epi16(static_cast<short>(at)), place, old);
    best = m;
  }
  void see(Sum32 t, int at) {
    half(t.a, at);
    half(t.b, at + 16);
  }
  u32 result() const {
    const __m256i lane = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m128i low = _mm_min_epu16(_mm256_castsi256_si128(best), _mm256_extracti128_si256(best, 1));
    const u32 least = static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(low))) & 0xffff;
    const __m256i is = _mm256_cmpeq_epi16(best, _mm256_set1_epi16(static_cast<short>(least)));
    const __m256i at = _mm256_or_si256(_mm256_add_epi16(place, lane), _mm256_xor_si256(is, _mm256_set1_epi8(-1)));
    const __m128i first = _mm_min_epu16(_mm256_castsi256_si128(at), _mm256_extracti128_si256(at, 1));
    return least << 16 | (static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(first))) & 0xffff);
  }
};
#ifndef __AVX512BW__
using V = V32;
using Running = Running32;
#endif

}  // namespace SGM_ISA
}  // namespace sgm
