// What the paths say together.

// Total costs of a block, in halves of words: of disparities 0 and 2, 1 and 3 of each four. Eight times the cost, what
// the eight paths add, and one where what the first sweep's four add is odd: the native module keeps half their sum,
// rounded up.
struct Totals {
  u32 even[4], odd[4];
};

__device__ inline Totals totals_at(const u8* cost, const u8* parts, u64 cells, u64 cell) {
  const Words<4> c = *(const Words<4>*)(cost + cell);
  Words<4> two[4];  // what two paths add: at most 254
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    const u8 *one = parts + 2 * k * cells + cell, *other = one + cells;
    const Words<4> a = *(const Words<4>*)one, b = *(const Words<4>*)other;
#pragma unroll
    for (int w = 0; w < 4; ++w) two[k].v[w] = a.v[w] + b.v[w];
  }
  Totals t;
#pragma unroll
  for (int w = 0; w < 4; ++w) {
    const u32 e = even(two[0].v[w]) + even(two[1].v[w]), o = odd(two[0].v[w]) + odd(two[1].v[w]);
    t.even[w] = e + (e & 0x10001u) + even(two[2].v[w]) + even(two[3].v[w]) + 8 * even(c.v[w]);
    t.odd[w] = o + (o & 0x10001u) + odd(two[2].v[w]) + odd(two[3].v[w]) + 8 * odd(c.v[w]);
  }
  return t;
}

__device__ inline u32 total_of(const u8* cost, const u8* parts, u64 cells, u64 cell) {
  u32 first = 0, second = 0;
  for (int k = 0; k < 4; ++k) {
    first += parts[k * cells + cell];
    second += parts[(k + 4) * cells + cell];
  }
  return first + (first & 1) + second + 8 * cost[cell];
}

// The winner of each pixel, total costs before, at and after it, and for each right pixel the cheapest left one.
template <int G>
__device__ void winners(const u8* cost, const u8* parts, const Ranges& r, u64 cells, int right_width, int uniqueness,
                        i16* best, u16* around, u32* right_best) {
  const u64 pixels = (u64)r.width * r.height, mine = THREAD / G, pixel = mine < pixels ? mine : pixels - 1;
  const int x = (int)(pixel % r.width), y = (int)(pixel / r.width), own = threadIdx.x % G;
  const Span span = span_of(r, pixel);
  const int limit = r.pixels ? span.n : r.count;
  u32 key = ALL;
  for (int b = BLOCK * own; b < limit; b += BLOCK * G) {
    const Totals t = totals_at(cost, parts, cells, span.cell + b);
#pragma unroll
    for (int w = 0; w < 4; ++w) {
      const int d = b + 4 * w;
      if (d < limit) key = min(key, t.even[w] << 16 | d);
      if (d + 1 < limit) key = min(key, t.odd[w] << 16 | (d + 1));
      if (d + 2 < limit) key = min(key, (t.even[w] & 0xffff0000u) | (d + 2));
      if (d + 3 < limit) key = min(key, (t.odd[w] & 0xffff0000u) | (d + 3));
    }
  }
  key = least_of_group<G>(key);
  const int at = (int)(key & 0xffffu);
  const u32 least = key >> 16;
  bool unique = true;
  for (int b = own; uniqueness > 0 && b < limit; b += G) {
    const bool near = b >= at - 1 && b <= at + 1;
    if (!near && total_of(cost, parts, cells, span.cell + b) * (100 - uniqueness) < least * 100) unique = false;
  }
  unique = least_of_group<G>(unique) != 0;
  if (mine >= pixels || own) return;
  const bool inner = at > 0 && at < limit - 1;
  around[pixel] = (u16)(inner ? total_of(cost, parts, cells, span.cell + at - 1) : least);
  around[pixels + pixel] = (u16)least;
  around[2 * pixels + pixel] = (u16)(inner ? total_of(cost, parts, cells, span.cell + at + 1) : least);
  const int disparity = span.first + at, there = x - disparity;
  best[pixel] = (i16)(unique ? disparity : NONE);
  if (there >= 0 && there < right_width) {
    atomicMin(right_best + (u64)y * right_width + there, least << 16 | (u32)(disparity - NONE));
  }
}

// Left-right check and sub-pixel part.
extern "C" __global__ void finish(const i16* best, const u16* around, const u32* right_best, int width, int height,
                                  int right_width, int left_right, int parabola, float* disparity) {
  const u64 pixels = (u64)width * height;
  if (THREAD >= pixels) return;
  const int x = (int)(THREAD % width), y = (int)(THREAD / width), winner = best[THREAD], there = x - winner;
  const int before = around[THREAD], at = around[pixels + THREAD], next = around[2 * pixels + THREAD];
  const int bend = parabola ? before + next - 2 * at : max(before, next) - at;  // 0 only where all three are equal
  const float part = (float)(before - next) / (float)(2 * (bend > 0 ? bend : 1));
  bool stands = winner != NONE;
  if (stands && left_right >= 0) {
    stands = there >= 0 && there < right_width;
    if (stands) {
      const int gap = (int)(right_best[(u64)y * right_width + there] & 0xffffu) + NONE - winner;
      stands = gap <= left_right && -gap <= left_right;
    }
  }
  disparity[THREAD] = stands ? (float)winner + part : __int_as_float(0x7fc00000);
}
