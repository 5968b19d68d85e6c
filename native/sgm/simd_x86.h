// 16 lanes of x86: SSE4.1, and what AVX2 or AVX-512 have for the same.
#pragma once
#include "types.h"
#include <immintrin.h>

namespace sgm {
namespace SGM_ISA {

// Bytes from i - 16 to i + 32 around a place in this table: a lane index, or 0x80 (= zero for pshufb) outside 0..15.
alignas(64) static const u8 kShift[64] = {
    128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128,
    128, 128, 128, 128, 128, 128, 128, 128, 0,   1,   2,   3,   4,   5,   6,   7,
    8,   9,   10,  11,  12,  13,  14,  15,  128, 128, 128, 128, 128, 128, 128, 128,
    128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128};

#ifdef __AVX2__
struct Sum16 {
  __m256i v;
  static Sum16 load(const u16* p) { return {_mm256_loadu_si256(reinterpret_cast<const __m256i*>(p))}; }
  void store(u16* p) const { _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), v); }
  static int at(int d) { return d; }  // where disparity d is stored
};
#else
struct Sum16 {
  __m128i a, b;
  static Sum16 load(const u16* p) {
    return {_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)),
            _mm_loadu_si128(reinterpret_cast<const __m128i*>(p + 8))};
  }
  void store(u16* p) const {
    _mm_storeu_si128(reinterpret_cast<__m128i*>(p), a);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(p + 8), b);
  }
  static int at(int d) { return d; }  // where disparity d is stored
};
#endif
struct B {
  enum { N = 16 };
  using Sum = Sum16;
  __m128i v;
  static B load(const u8* p) { return {_mm_loadu_si128(reinterpret_cast<const __m128i*>(p))}; }
  void store(u8* p) const { _mm_storeu_si128(reinterpret_cast<__m128i*>(p), v); }
  void stream(u8* p) const { _mm_stream_si128(reinterpret_cast<__m128i*>(p), v); }
  static B set1(u8 a) { return {_mm_set1_epi8(static_cast<char>(a))}; }
};
static inline B vmin(B a, B b) { return {_mm_min_epu8(a.v, b.v)}; }
static inline B band(B a, B b) { return {_mm_and_si128(a.v, b.v)}; }
static inline B bxor(B a, B b) { return {_mm_xor_si128(a.v, b.v)}; }
static inline void stream_end() { _mm_sfence(); }
static inline B bits(B a) {
#if defined(__AVX512BITALG__)
  return {_mm_popcnt_epi8(a.v)};
#else
  const __m128i lut = _mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4), low = _mm_set1_epi8(15);
  return {_mm_add_epi8(_mm_shuffle_epi8(lut, _mm_and_si128(a.v, low)),
                       _mm_shuffle_epi8(lut, _mm_and_si128(_mm_srli_epi16(a.v, 4), low)))};
#endif
}
static inline B add(B a, B b) { return {_mm_add_epi8(a.v, b.v)}; }
static inline B sub(B a, B b) { return {_mm_sub_epi8(a.v, b.v)}; }
static inline B adds(B a, B b) { return {_mm_adds_epu8(a.v, b.v)}; }
static inline B absdiff(B a, B b) { return {_mm_or_si128(_mm_subs_epu8(a.v, b.v), _mm_subs_epu8(b.v, a.v))}; }
static inline B avg(B a, B b) { return {_mm_avg_epu8(a.v, b.v)}; }
static inline B below_or_equal(B a, B b) { return {_mm_cmpeq_epi8(_mm_min_epu8(a.v, b.v), a.v)}; }
static inline B steps(B a) {
  const __m128i s = _mm_and_si128(_mm_srli_epi16(a.v, kStepShift), _mm_set1_epi8(0xff >> kStepShift));
  return {_mm_min_epu8(s, _mm_set1_epi8(15))};
}
static inline B lookup(B table, B index) { return {_mm_shuffle_epi8(table.v, index.v)}; }
static inline B before(B a) { return {_mm_alignr_epi8(a.v, _mm_set1_epi8(-1), 15)}; }
static inline B after(B a) { return {_mm_alignr_epi8(_mm_set1_epi8(-1), a.v, 1)}; }
// Lanes moved by one across neighbouring vectors.
static inline B before(B previous, B a) { return {_mm_alignr_epi8(a.v, previous.v, 15)}; }
static inline B after(B a, B next) { return {_mm_alignr_epi8(next.v, a.v, 1)}; }
static inline B shifted(B a, int by) {
  return {_mm_shuffle_epi8(a.v, _mm_loadu_si128(reinterpret_cast<const __m128i*>(kShift + 24 + by)))};
}
static inline __m128i least_word(B a) { return _mm_minpos_epu16(_mm_min_epu8(a.v, _mm_srli_epi16(a.v, 8))); }
static inline u8 hmin(B a) { return static_cast<u8>(_mm_cvtsi128_si32(least_word(a))); }
static inline B hmin_all(B a) { return {_mm_shuffle_epi8(least_word(a), _mm_setzero_si128())}; }

#if defined(__AVX512VPOPCNTDQ__)
static inline B hamming(const u64* right, u64 left) {
  const __m512i c = _mm512_set1_epi64(static_cast<long long>(left));
  const __m512i a = _mm512_popcnt_epi64(_mm512_xor_si512(_mm512_loadu_si512(right), c));
  const __m512i b = _mm512_popcnt_epi64(_mm512_xor_si512(_mm512_loadu_si512(right + 8), c));
  return {_mm_unpacklo_epi64(_mm512_cvtepi64_epi8(a), _mm512_cvtepi64_epi8(b))};
}
#elif defined(__AVX2__)
static inline __m256i bits_of_four(const u64* right, __m256i c, __m256i lut) {
  const __m256i low = _mm256_set1_epi8(15);
  const __m256i x = _mm256_xor_si256(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(right)), c);
  const __m256i n = _mm256_add_epi8(_mm256_shuffle_epi8(lut, _mm256_and_si256(x, low)),
                                    _mm256_shuffle_epi8(lut, _mm256_and_si256(_mm256_srli_epi16(x, 4), low)));
  return _mm256_sad_epu8(n, _mm256_setzero_si256());
}
static inline B hamming(const u64* right, u64 left) {
  const __m256i lut = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4));
  const __m256i c = _mm256_set1_epi64x(static_cast<long long>(left));
  const __m256i p = bits_of_four(right, c, lut), q = bits_of_four(right + 4, c, lut);
  const __m256i r = bits_of_four(right + 8, c, lut), s = bits_of_four(right + 12, c, lut);
  // Words of each half: p q p q r s r s of its two places.
  const __m256i t = _mm256_packus_epi32(_mm256_or_si256(p, _mm256_slli_epi64(q, 32)),
                                        _mm256_or_si256(r, _mm256_slli_epi64(s, 32)));
  const __m128i u = _mm_packus_epi16(_mm256_castsi256_si128(t), _mm256_extracti128_si256(t, 1));
  return {_mm_shuffle_epi8(u, _mm_setr_epi8(0, 2, 8, 10, 1, 3, 9, 11, 4, 6, 12, 14, 5, 7, 13, 15))};
}
#else
static inline __m128i bits_of_two(const u64* right, __m128i c) {
  const __m128i lut = _mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4), low = _mm_set1_epi8(15);
  const __m128i x = _mm_xor_si128(_mm_loadu_si128(reinterpret_cast<const __m128i*>(right)), c);
  const __m128i n = _mm_add_epi8(_mm_shuffle_epi8(lut, _mm_and_si128(x, low)),
                                 _mm_shuffle_epi8(lut, _mm_and_si128(_mm_srli_epi16(x, 4), low)));
  return _mm_sad_epu8(n, _mm_setzero_si128());
}
static inline B hamming(const u64* right, u64 left) {
  const __m128i c = _mm_set1_epi64x(static_cast<long long>(left));
  __m128i w[4];
  for (int k = 0; k < 4; ++k) {  // two sums in each, at words 0 and 4
    w[k] = _mm_packus_epi32(bits_of_two(right + 4 * k, c), bits_of_two(right + 4 * k + 2, c));
  }
  // Even words hold the sums: as 32-bit numbers they pack once more.
  const __m128i lo = _mm_packus_epi32(w[0], w[1]), hi = _mm_packus_epi32(w[2], w[3]);
  return {_mm_packus_epi16(lo, hi)};
}
#endif

#ifdef __AVX2__
static inline Sum16 pair_sum(B a, B b) {
  return {_mm256_add_epi16(_mm256_cvtepu8_epi16(a.v), _mm256_cvtepu8_epi16(b.v))};
}
static inline Sum16 eightfold(B a) { return {_mm256_slli_epi16(_mm256_cvtepu8_epi16(a.v), 3)}; }
static inline Sum16 add(Sum16 a, Sum16 b) { return {_mm256_add_epi16(a.v, b.v)}; }
static inline __m128i lower(Sum16 a) { return _mm256_castsi256_si128(a.v); }
static inline __m128i upper(Sum16 a) { return _mm256_extracti128_si256(a.v, 1); }
#else
static inline Sum16 pair_sum(B a, B b) {
  const __m128i one = _mm_set1_epi8(1);
  return {_mm_maddubs_epi16(_mm_unpacklo_epi8(a.v, b.v), one), _mm_maddubs_epi16(_mm_unpackhi_epi8(a.v, b.v), one)};
}
static inline Sum16 eightfold(B a) {
  const __m128i zero = _mm_setzero_si128();
  return {_mm_slli_epi16(_mm_unpacklo_epi8(a.v, zero), 3), _mm_slli_epi16(_mm_unpackhi_epi8(a.v, zero), 3)};
}
static inline Sum16 add(Sum16 a, Sum16 b) { return {_mm_add_epi16(a.a, b.a), _mm_add_epi16(a.b, b.b)}; }
static inline __m128i lower(Sum16 a) { return a.a; }
static inline __m128i upper(Sum16 a) { return a.b; }
#endif
static inline u32 argmin(Sum16 a) {
  const u32 p = static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(lower(a))));
  const u32 q = static_cast<u32>(_mm_cvtsi128_si32(_mm_minpos_epu16(upper(a))));
  const u32 x = p << 16 | p >> 16, y = (q << 16 | q >> 16) + 8;
  return x < y ? x : y;
}
static inline void interleave(const u8* planes, std::ptrdiff_t stride, u64* out) {
  __m128i p[8], q[8], r[8];
  for (int k = 0; k < 8; ++k) p[k] = _mm_loadu_si128(reinterpret_cast<const __m128i*>(planes + k * stride));
  for (int k = 0; k < 4; ++k) {
    q[k] = _mm_unpacklo_epi8(p[2 * k], p[2 * k + 1]);      // pixels 0..7, planes 2k 2k+1
    q[k + 4] = _mm_unpackhi_epi8(p[2 * k], p[2 * k + 1]);  // pixels 8..15
  }
  for (int h = 0; h < 2; ++h) {
    r[4 * h] = _mm_unpacklo_epi16(q[4 * h], q[4 * h + 1]);
    r[4 * h + 1] = _mm_unpackhi_epi16(q[4 * h], q[4 * h + 1]);
    r[4 * h + 2] = _mm_unpacklo_epi16(q[4 * h + 2], q[4 * h + 3]);
    r[4 * h + 3] = _mm_unpackhi_epi16(q[4 * h + 2], q[4 * h + 3]);
    for (int g = 0; g < 2; ++g) {
      __m128i* o = reinterpret_cast<__m128i*>(out + 8 * h + 4 * g);
      _mm_storeu_si128(o, _mm_unpacklo_epi32(r[4 * h + g], r[4 * h + g + 2]));
      _mm_storeu_si128(o + 1, _mm_unpackhi_epi32(r[4 * h + g], r[4 * h + g + 2]));
    }
  }
}

#include "running.inl"
#ifndef __AVX2__
using V = B;
using Running = Running16;
#endif
#ifndef __AVX512BW__
using W = B;
using RunningW = Running16;
#endif

}  // namespace SGM_ISA
}  // namespace sgm
