// What the matcher's parts share. Units: disparity d = x_left - x_right in pixels; costs are whole numbers.
#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace sgm {

using u8 = std::uint8_t;
using u16 = std::uint16_t;
using u32 = std::uint32_t;
using u64 = std::uint64_t;
using i16 = std::int16_t;

constexpr int kMargin = 64;        // readable pixels left and right of every padded image row
constexpr int kBlock = 16;         // a per-pixel range is a whole number of blocks of 16 disparities
constexpr int kSlack = 256;        // bytes of every buffer beyond its last element: vectors may read over the end
constexpr i16 kNone = -32768;      // a pixel without a disparity
constexpr u8 kFar = 255;           // path cost outside a range: saturating sums keep it there
constexpr int kStepShift = 2;      // grey steps are counted in fours for the adaptive penalty

enum class CostMode : int { census = 0, blend = 1, mutual = 2 };

// One pair to be matched. Images are padded (kMargin left and right, the census radius above and below, edge pixels
// repeated) and their pointers stand at pixel (0, 0). The right image is mirrored, so that disparities ascend with it.
struct Job {
  int width, height, right_width;
  const u8* left;
  std::ptrdiff_t left_stride;
  const u8* right;
  std::ptrdiff_t right_stride;
  int radius_x, radius_y;          // census window; (2 rx + 1)(2 ry + 1) - 1 <= 64

  bool ragged;
  int low, count, padded;          // dense: first disparity, number, number rounded up to whole vectors
  const i16* first;                // ragged (height, width): first disparity of each pixel
  const u8* blocks;                // ragged (height, width): number of disparities / kBlock, at least 1
  const u64* row_offset;           // (height + 1): where a row begins in cost and sum

  u8 small, large;                 // P1, P2
  u8 large_by_step[16];            // adaptive P2 by min(grey step >> kStepShift, 15), each <= large
  u8 outside;                      // cost of disparities that lead out of the right image
  CostMode mode;
  const u8* mutual;                // (256, 256) cost of a left and a right grey value

  int uniqueness;                  // percent by which the best must beat all but its neighbours
  int left_right;                  // largest disagreement between both directions, < 0 = no check
  int parabola;                    // sub-pixel: 1 parabola, 0 equiangular lines

  u8* cost;                        // ragged (row_offset[height]): matching cost
  u8* sum;                         // (row_offset[height]): half the sum of the first sweep's four paths, rounded up
  bool streamed;                   // sums bypass the caches: they would only fill them
  float* disparity;                // out (height, width), NaN = none
  u16* score;                      // out (height, width) or null: smallest total cost
};

// Path costs of one row, read by the next one. Ragged: messages, kBlock guard bytes after each pixel.
struct Row {
  u8* path[3];
  u8* least;                       // dense: smallest path costs of each pixel, a byte for each path
  u32* at;                         // ragged: where a pixel begins in path
};

constexpr int kSlots = 4;          // dense: pixels of which a row of a band keeps path costs for the next row
constexpr int kBehind = 2;         // dense: pixels by which a row of a band lags behind the row before it

// Private buffers of one thread; dense: of one row of the band that a thread has in work.
struct Scratch {
  u64* left_census;                // ragged
  u64* right_census;               // ragged: stands at mirrored pixel 0; kBlock readable before and after
  u8* left_planes;                 // 8 x plane_stride bytes of the census, the first is pixel 0
  u8* right_planes;                // likewise, mirrored; kMargin readable before and after
  std::ptrdiff_t plane_stride;
  Row near;                        // dense: kSlots pixels of this row
  u8* cost;                        // costs of one pixel
  u8* penalty[4];                  // adaptive P2 of each pixel towards its predecessor on each path
  u32* from[3];                    // ragged: where the predecessor's message is read
  u8* lines[4];                    // path costs of one pixel (kMargin before)
  u8* beside[2];                   // path cost of the neighbour in the row (kMargin before)
  u8* zero;
  u16* total;                      // total cost of one pixel (kBlock before)
  i16* best;
  u16* around[3];                  // total cost before, at, after the best
  u32* right_best;                 // cost << 16 | disparity - lowest, of each right pixel
};

struct Sweep {
  const Job* job;
  int thread, threads;
  Row* ring;                       // ragged: threads + 1 rows; dense: one, the last row of the band before
  int bands;                       // dense: numbers of rows that are matched together
  Scratch* scratch;                // dense: of each row of a band
  std::atomic<int>* done;          // pixels finished in each row (dense: in the last row of each band)
  int lowest;                      // smallest disparity of the whole job
  void (*yield)();                 // lets another thread run
};

struct Kernel {
  const char* name;
  int lanes;                       // dense ranges are padded to multiples of this
  void (*forward)(const Sweep&);
  void (*backward)(const Sweep&);
};

const Kernel* kernels(int* number);  // best first, only what this machine can run

}  // namespace sgm
