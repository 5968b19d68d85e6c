// The matcher of native/sgm on a GPU: the same whole numbers, so the same bits. Compiled at run time (dense/cuda.py).
//
// Each of the eight paths is walked by a group of G lanes, words of four neighbouring disparities a lane; what a path
// adds to the matching cost (0 .. P2, one byte) goes to memory, and one more kernel sums up and finds the winners. The
// right image is not mirrored here.
// Units: disparity d = x_left - x_right in pixels; costs are whole numbers. No libraries are included.

typedef unsigned char u8;
typedef unsigned short u16;
typedef short i16;
typedef unsigned int u32;
typedef unsigned long long u64;

#define ALL 0xffffffffu     // lanes of a warp
#define BYTES 0x00ff00ffu   // two bytes in two halves of a word
#define BLOCK 16            // disparities of a block
#define GUARD 32            // bytes of 255 before and after the path costs of a pixel
#define EMPTY 32000         // least of nothing; the most of nothing is its negative
#define NONE (-32768)       // a pixel without a disparity
#define HOLE_LEVEL 2        // a hole asks cells of 4 x 4 coarse pixels and their neighbours first

__device__ inline int clamped(int x, int low, int high) { return x < low ? low : x > high ? high : x; }
__device__ inline u32 even(u32 v) { return v & BYTES; }
__device__ inline u32 odd(u32 v) { return v >> 8 & BYTES; }

// The disparities of a pixel in the volumes.
struct Span {
  int first, n;         // n: as stored, a multiple of 16
  u64 cell;             // where it begins
};

// A pixel with a range of its own, eight bytes: one load.
struct Pixel {
  u32 block;            // where it begins in the volumes, in blocks of 16
  i16 first;
  u8 blocks, grey;
};

// The disparities of all pixels: one range (pixels null), or each its own.
struct Ranges {
  const Pixel* pixels;
  int low, count, padded, width, height;
};

__device__ inline Span span_of(const Ranges& r, u64 pixel) {
  if (!r.pixels) return {r.low, r.padded, pixel * r.padded};
  const Pixel p = r.pixels[pixel];
  return {p.first, 16 * p.blocks, 16ull * p.block};
}

#define RANGES const Pixel *pixels, int low, int count, int padded, int width, int height
#define RANGES_HERE const Ranges ranges = {pixels, low, count, padded, width, height}
#define THREAD ((u64)blockIdx.x * blockDim.x + threadIdx.x)

// W words of four disparities.
template <int W>
struct alignas(W < 4 ? 4 * W : 16) Words {
  u32 v[W];
};

// The least of the values of G neighbouring lanes.
template <int G>
__device__ inline u32 least_of_group(u32 key) {
  for (int other = G / 2; other; other /= 2) key = min(key, __shfl_xor_sync(ALL, key, other, 32));
  return key;
}
