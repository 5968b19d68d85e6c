// The eight paths.

// A path through one strip. Diagonal paths that leave the image begin anew on the other side.
struct Way {
  int x, y, step_x, step_y, i, length, width;
  bool begins;          // there is no pixel before

  __device__ bool ended() const { return i >= length; }
  __device__ u64 pixel() const { return (u64)y * width + x; }
  __device__ void go_on() {
    x += step_x;
    y += step_y;
    ++i;
    begins = x < 0 || x >= width;
    if (begins && step_y) x += x < 0 ? width : -width;
  }
};

// Directions 0 to 3 are the native module's first sweep, 4 to 7 the second. The longest paths, along rows (0 and 4),
// begin first.
__device__ inline int direction_here() {
  const int y = blockIdx.y;
  return y == 1 ? 4 : y > 1 && y < 5 ? y - 1 : y;
}

// A warp's paths, 32 / G, lie in one strip and are equally long; those too many do the last one again.
template <int G>
__device__ inline Way way_of(const Ranges& r, const int* strips, int direction) {
  const int forward = direction < 4 ? 1 : -1, kind = direction % 4, each = 32 / G, own = threadIdx.x % 32 / G;
  const int warp = (int)(THREAD / 32), warps = (r.width + each - 1) / each;
  const int row = min(warp * each + own, r.height - 1);
  if (!kind) return {forward > 0 ? 0 : r.width - 1, row, forward, 0, 0, r.width, r.width, true};
  const int strip = warp / warps, top = strips[strip], rows = strips[strip + 1] - top;
  const int x = min(warp % warps * each + own, r.width - 1), y = forward > 0 ? top : top + rows - 1;
  return {x, y, forward * (kind == 3 ? -1 : kind == 1), forward, 0, rows, r.width, true};
}

// Whether this warp has paths at all: a launch has the same number of warps for all directions.
template <int G>
__device__ inline bool idle(const Ranges& r, int number, int direction) {
  const int each = 32 / G, warp = (int)(THREAD / 32);
  return direction % 4 ? warp >= number * ((r.width + each - 1) / each) : warp * each >= r.height;
}

__device__ inline u32 doubled(u32 v) { return v * 0x10001u; }
__device__ inline u32 packed(u32 even, u32 odd) { return even + (odd << 8); }

// What a path adds to the costs of disparities, from the path costs of the pixel before:
// min(L(d), L(d - 1) + P1, L(d + 1) + P1, min L + P2) - min L.
__device__ inline u32 added(u32 less, u32 same, u32 more, u32 small, u32 jump, u32 base) {
  return __vminu2(__vminu2(__vminu2(less, more) + small, same), jump) - base;
}

__device__ inline u32 penalty_of(const u8* table, bool begins, int grey, int before) {
  return begins ? 0u : (u32)table[min(abs(grey - before) >> 2, 15)];
}

// One range for all pixels: path costs stay in registers, W words of four disparities a lane.
template <int G, int W>
__device__ void dense_paths(const u8* cost, const u8* image, const u8* table, const Ranges& r, const int* strips,
                            int number, int small, u64 cells, u8* parts) {
  const int own = threadIdx.x % G, b = 4 * W * own;
  const int direction = direction_here();
  if (idle<G>(r, number, direction)) return;
  Way way = way_of<G>(r, strips, direction);
  const bool has = b < r.padded;
  const u8* from = cost + b;
  u8* out = parts + direction * cells + b;
  const u32 step = doubled(small);
  u32 e[W], o[W], base = 0;
  Words<W> ahead;
  for (int w = 0; w < W; ++w) {
    e[w] = o[w] = 0;
    ahead.v[w] = ALL;
  }
  u64 cell = way.pixel() * r.padded;
  bool begins = true;
  int grey = image[way.pixel()], grey_before = grey;
  if (has) ahead = *(const Words<W>*)(from + cell);
  while (!way.ended()) {
    const Words<W> now = ahead;
    const u64 cell_now = cell;
    const u32 penalty = penalty_of(table, begins, grey, grey_before);
    grey_before = grey;
    way.go_on();
    begins = way.begins;
    if (!way.ended()) {
      cell = way.pixel() * r.padded;
      grey = image[way.pixel()];
      if (has) ahead = *(const Words<W>*)(from + cell);
    }
    const u32 before = __shfl_up_sync(ALL, o[W - 1], 1, G), after = __shfl_down_sync(ALL, e[0], 1, G);
    const u32 low = doubled(base), jump = low + doubled(penalty);
    u32 least = ALL, last = own ? before : 0xff0000u;  // odd disparities of the word before
    Words<W> part;
#pragma unroll
    for (int w = 0; w < W; ++w) {
      const u32 next = w + 1 < W ? e[w + 1 < W ? w + 1 : w] : own + 1 < G ? after : 0xffu;
      const u32 pe = added(__byte_perm(last, o[w], 0x5432), e[w], o[w], step, jump, low);
      const u32 po = added(e[w], o[w], __byte_perm(e[w], next, 0x5432), step, jump, low);
      last = o[w];
      part.v[w] = packed(pe, po);
      e[w] = even(now.v[w]) + pe;
      o[w] = odd(now.v[w]) + po;
      least = __vminu2(least, __vminu2(e[w], o[w]));
    }
    if (has) *(Words<W>*)(out + cell_now) = part;
    base = least_of_group<G>(min(least & 0xffffu, least >> 16));
  }
}

// Ranges of their own, blocks of 16: a block a lane. The path costs of the pixel before, n bytes, stand in shared
// memory with 255 before and behind. What the path adds to the costs of the block that stands at `at` in the range of
// the pixel before: P2 outside that range.
__device__ inline Words<4> added_at(const u32* before, int at, int n, u32 base, u32 penalty, u32 small) {
  const int i = clamped(at, -BLOCK - 1, n + 1), a = i - 1 + GUARD, shift = (a & 3) * 8;
  const u32 *p = before + (a >> 2), low = doubled(base), jump = low + doubled(penalty), shared_low = low + (low << 8);
  u32 word = p[0], next = p[1];
  const u32 first = __funnelshift_r(word, next, shift);
  u32 e = even(first), o = odd(first);  // of L(d - 1)
  Words<4> part;
#pragma unroll
  for (int w = 0; w < 4; ++w) {
    word = next;
    next = p[w + 2];
    const u32 following = __funnelshift_r(word, next, shift), e_next = even(following), o_next = odd(following);
    const u32 same = __byte_perm(e, e_next, 0x5432), more = __byte_perm(o, o_next, 0x5432);
    const u32 pe = __vminu2(__vminu2(__vminu2(e, same) + small, o), jump);
    const u32 po = __vminu2(__vminu2(__vminu2(o, more) + small, same), jump);
    part.v[w] = packed(pe, po) - shared_low;
    e = e_next;
    o = o_next;
  }
  if (i < 0 || i > n - BLOCK) {
#pragma unroll
    for (int w = 0; w < 4; ++w) {
      const int less = -i - 4 * w, more = i + 4 * w + 4 - n;  // disparities before and behind the range
      u32 inside = less >= 4 || more >= 4 ? 0u : ALL;
      if (less > 0 && less < 4) inside &= ALL << (8 * less);
      if (more > 0 && more < 4) inside &= ALL >> (8 * more);
      part.v[w] = (part.v[w] & inside) | (penalty * 0x01010101u & ~inside);
    }
  }
  return part;
}

__device__ inline Pixel pixel_at(const Ranges& r, const Way& way) {
  return way.ended() ? Pixel{0, 0, 0, 0} : r.pixels[way.pixel()];
}

#define FETCHED 4  // blocks a lane holds of the costs of the next pixel: more are read when they are needed

__device__ inline Words<4> block_of(const u8* cost, const Pixel& p, int block) {
  return block < p.blocks ? *(const Words<4>*)(cost + 16ull * (p.block + block)) : Words<4>{{0, 0, 0, 0}};
}

// One block of a pixel: what the path adds goes to memory, the path costs to `line`. Returns the least of these, in
// halves.
__device__ inline u32 step_of(const Words<4>& cost, const Words<4>& part, u8* out, u32* line) {
  *(Words<4>*)out = part;
  Words<4> sum;
  u32 least = ALL;
#pragma unroll
  for (int w = 0; w < 4; ++w) {
    sum.v[w] = cost.v[w] + part.v[w];
    least = __vminu2(least, __vminu2(even(sum.v[w]), odd(sum.v[w])));
  }
  *(Words<4>*)line = sum;
  return least;
}

template <int G>
__device__ void ragged_paths(const u8* cost, const u8* table, const Ranges& r, const int* strips, int number, int small,
                             int pitch, u64 cells, u8* parts) {
  extern __shared__ __align__(16) u32 shared[];
  const int own = threadIdx.x % G, direction = direction_here();
  if (idle<G>(r, number, direction)) return;
  Way way = way_of<G>(r, strips, direction);
  u32 *line = shared + threadIdx.x / G * 2 * (pitch / 4), *before = line + pitch / 4;
  for (int i = own; i < pitch / 4; i += G) line[i] = before[i] = ALL;
  u8* out = parts + direction * cells;
  const u32 step = doubled(small);
  bool begins = true;
  Pixel here = pixel_at(r, way);
  way.go_on();
  bool begins_next = way.begins;
  Pixel next = pixel_at(r, way), last = {0, 0, 0, 0};
  Words<4> ahead[FETCHED];
  u32 base = 0;
  for (int k = 0; k < FETCHED; ++k) ahead[k] = block_of(cost, here, own + k * G);
  __syncwarp(ALL);
  while (here.blocks) {
    Words<4> now[FETCHED];
#pragma unroll
    for (int k = 0; k < FETCHED; ++k) {
      now[k] = ahead[k];
      ahead[k] = block_of(cost, next, own + k * G);
    }
    if (!way.ended()) way.go_on();
    const Pixel later = pixel_at(r, way);
    const u32 penalty = penalty_of(table, begins, here.grey, last.grey);
    const int n_before = 16 * last.blocks, offset = here.first - last.first;
    u8* to = out + 16ull * here.block;
    u32 least = ALL;
#pragma unroll
    for (int k = 0; k < FETCHED; ++k) {
      const int b = own + k * G;
      if (b >= here.blocks) break;
      const Words<4> part = added_at(before, offset + 16 * b, n_before, base, penalty, step);
      least = __vminu2(least, step_of(now[k], part, to + 16 * b, line + (GUARD + 16 * b) / 4));
    }
    for (int b = own + FETCHED * G; b < here.blocks; b += G) {
      const Words<4> part = added_at(before, offset + 16 * b, n_before, base, penalty, step);
      least = __vminu2(least, step_of(block_of(cost, here, b), part, to + 16 * b, line + (GUARD + 16 * b) / 4));
    }
    Words<4>* behind = (Words<4>*)(line + GUARD / 4) + here.blocks;
    for (int i = own; i < GUARD / 16; i += G) behind[i] = {{ALL, ALL, ALL, ALL}};
    base = least_of_group<G>(min(least & 0xffffu, least >> 16));
    last = here;
    here = next;
    next = later;
    begins = begins_next;
    begins_next = way.begins;
    u32* other = line;
    line = before;
    before = other;
    __syncwarp(ALL);
  }
}
