// 64 lanes of AVX-512 for the dense form.
#pragma once
#include "simd_avx2.h"

namespace sgm {
namespace SGM_ISA {

struct Sum64 {
  __m512i a, b;
  static Sum64 load(const u16* p) { return {_mm512_loadu_si512(p), _mm512_loadu_si512(p + 32)}; }
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
  static V64 set1(u8 a) { return {_mm512_set1_epi8(static_cast<char>(a))}; }
};
static inline V64 vmin(V64 a, V64 b) { return {_mm512_min_epu8(a.v, b.v)}; }
static inline V64 add(V64 a, V64 b) { return {_mm512_add_epi8(a.v, b.v)}; }
static inline V64 sub(V64 a, V64 b) { return {_mm512_sub_epi8(a.v, b.v)}; }
static inline V64 adds(V64 a, V64 b) { return {_mm512_adds_epu8(a.v, b.v)}; }
static inline V64 avg(V64 a, V64 b) { return {_mm512_avg_epu8(a.v, b.v)}; }
static inline V64 below_or_equal(V64 a, V64 b) { return {_mm512_movm_epi8(_mm512_cmple_epu8_mask(a.v, b.v))}; }
static inline u8 hmin(V64 a) {
  return hmin(V32{_mm256_min_epu8(_mm512_castsi512_si256(a.v), _mm512_extracti64x4_epi64(a.v, 1))});
}
static inline __m512i quarters(__m512i a) {
  return _mm512_permutexvar_epi64(_mm512_setr_epi64(0, 4, 1, 5, 2, 6, 3, 7), a);
}
static inline Sum64 pair_sum(V64 a, V64 b) {
  const __m512i one = _mm512_set1_epi8(1), p = quarters(a.v), q = quarters(b.v);
  return {_mm512_maddubs_epi16(_mm512_unpacklo_epi8(p, q), one), _mm512_maddubs_epi16(_mm512_unpackhi_epi8(p, q), one)};
}
static inline Sum64 eightfold(V64 a) {
  const __m512i zero = _mm512_setzero_si512(), p = quarters(a.v);
  return {_mm512_slli_epi16(_mm512_unpacklo_epi8(p, zero), 3), _mm512_slli_epi16(_mm512_unpackhi_epi8(p, zero), 3)};
}
static inline Sum64 add(Sum64 a, Sum64 b) { return {_mm512_add_epi16(a.a, b.a), _mm512_add_epi16(a.b, b.b)}; }

struct Running64 {
  __m512i best = _mm512_set1_epi16(-1), place = _mm512_setzero_si512();
  void half(__m512i t, int at) {
    const __mmask32 less = _mm512_cmplt_epu16_mask(t, best);
    place = _mm512_mask_blend_epi16(less, place, _mm512_set1_epi16(static_cast<short>(at)));
    best = _mm512_min_epu16(t, best);
  }
  void see(Sum64 t, int at) {
    half(t.a, at);
    half(t.b, at + 32);
  }
  static u32 least_of(__m512i a) {
    const __m256i h = _mm256_min_epu16(_mm512_castsi512_si256(a), _mm512_extracti64x4_epi64(a, 1));
    const __m128i q = _mm_min_epu16(_mm256_castsi256_si128(h), _mm256_extracti128_si256(h, 1));
    return static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(q))) & 0xffff;
  }
  u32 result() const {
    alignas(64) static const u16 lanes[32] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15,
                                              16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31};
    const u32 least = least_of(best);
    const __mmask32 is = _mm512_cmpeq_epi16_mask(best, _mm512_set1_epi16(static_cast<short>(least)));
    const __m512i at = _mm512_add_epi16(place, _mm512_load_si512(lanes));
    return least << 16 | least_of(_mm512_mask_blend_epi16(is, _mm512_set1_epi16(-1), at));
  }
};
static inline V64 hamming_wide(const u64* right, u64 left, V64*) {
  const V32 a = hamming_wide(right, left, static_cast<V32*>(nullptr));
  const V32 b = hamming_wide(right + 32, left, static_cast<V32*>(nullptr));
  return {_mm512_inserti64x4(_mm512_castsi256_si512(a.v), b.v, 1)};
}
using V = V64;
using Running = Running64;

}  // namespace SGM_ISA
}  // namespace sgm
