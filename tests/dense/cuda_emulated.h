// Enough of CUDA to run the kernels of src/tiegraph/dense/kernels on a CPU, warp by warp: the lanes of a warp are contexts that take turns at each
// function that all lanes call together.
#include <ucontext.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

using std::max;
using std::min;
#define __global__
#define __device__
#define __shared__
#define __align__(n)
struct Index { unsigned x, y; };
static Index blockIdx, blockDim, threadIdx;
alignas(16) unsigned shared[1 << 16];

constexpr int kLanes = 32, kStack = 64 << 10;
static ucontext_t lanes[kLanes], driver;
static char stacks[kLanes][kStack];
static bool ended[kLanes];
static int lane;
static unsigned told[kLanes], heard[kLanes];

static void pause_lane() {
  const Index mine = threadIdx;
  swapcontext(&lanes[lane], &driver);
  threadIdx = mine;
}

// All lanes tell before any goes on: `heard` is what was told in this round.
static unsigned* exchange(unsigned value) {
  told[lane] = value;
  pause_lane();
  return heard;
}
static void __syncwarp(unsigned) { pause_lane(); }
static unsigned __shfl_xor_sync(unsigned, unsigned v, int mask, int) { const int l = lane; return exchange(v)[l ^ mask]; }
static unsigned __shfl_sync(unsigned, unsigned v, int from, int) { return exchange(v)[from]; }
static unsigned __shfl_up_sync(unsigned, unsigned v, int by, int width) {
  const int l = lane;
  return exchange(v)[l % width >= by ? l - by : l];
}
static unsigned __shfl_down_sync(unsigned, unsigned v, int by, int width) {
  const int l = lane;
  return exchange(v)[l % width + by < width ? l + by : l];
}
static int __popcll(unsigned long long v) { return __builtin_popcountll(v); }
static int __float2int_rn(float v) { return static_cast<int>(std::lrintf(v)); }
static float __int_as_float(int v) { float f; std::memcpy(&f, &v, 4); return f; }
static unsigned __funnelshift_r(unsigned low, unsigned high, int by) {
  return static_cast<unsigned>((static_cast<std::uint64_t>(high) << 32 | low) >> (by & 31));
}
static unsigned __byte_perm(unsigned a, unsigned b, unsigned selector) {
  const std::uint64_t all = static_cast<std::uint64_t>(b) << 32 | a;
  unsigned out = 0;
  for (int k = 0; k < 4; ++k) out |= static_cast<unsigned>(all >> (8 * (selector >> (4 * k) & 7)) & 255) << (8 * k);
  return out;
}
static unsigned __vminu2(unsigned a, unsigned b) {
  return min(a >> 16, b >> 16) << 16 | min(a & 0xffffu, b & 0xffffu);
}
static void atomicAdd(unsigned* p, unsigned v) { *p += v; }
static void atomicMin(unsigned* p, unsigned v) { *p = min(*p, v); }

using Word = unsigned long long;
using Kernel = void (*)(Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word, Word,
                        Word, Word, Word, Word, Word, Word, Word, Word);
static Kernel kernel;
static const Word* w;

static void lane_body() {
  kernel(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8], w[9], w[10], w[11], w[12], w[13], w[14], w[15], w[16],
         w[17], w[18], w[19], w[20], w[21], w[22], w[23]);
  ended[lane] = true;
}

static void run_warp(int begin) {
  for (lane = 0; lane < kLanes; ++lane) {
    getcontext(&lanes[lane]);
    lanes[lane].uc_stack.ss_sp = stacks[lane];
    lanes[lane].uc_stack.ss_size = kStack;
    lanes[lane].uc_link = &driver;
    makecontext(&lanes[lane], lane_body, 0);
    ended[lane] = false;
  }
  for (int left = kLanes; left;) {
    left = 0;
    for (lane = 0; lane < kLanes; ++lane) {
      if (ended[lane]) continue;
      threadIdx = {static_cast<unsigned>(begin + lane), 0};
      swapcontext(&driver, &lanes[lane]);
      left += !ended[lane];
    }
    std::memcpy(heard, told, sizeof told);
  }
}

extern "C" void launch(void* function, unsigned blocks_x, unsigned blocks_y, unsigned threads, const Word* arguments) {
  kernel = reinterpret_cast<Kernel>(function);
  w = arguments;
  blockDim = {threads, 1};
  for (unsigned y = 0; y < blocks_y; ++y) {
    for (unsigned x = 0; x < blocks_x; ++x) {
      blockIdx = {x, y};
      std::memset(shared, 0xa5, sizeof shared);
      for (unsigned t = 0; t < threads; t += kLanes) run_warp(static_cast<int>(t));
    }
  }
}
