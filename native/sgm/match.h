// Matching of one rectified pair: memory, threads and the two sweeps around the kernels.
#pragma once
#include "types.h"
#include <string>
#include <vector>

namespace sgm {

// What the caller decides; the defaults are the ones of the dense stage.
struct Options {
  int radius_x = 4, radius_y = 3;
  int small = 20, large = 120;
  std::vector<int> large_by_step;  // 16 entries, empty = `large` everywhere
  int uniqueness = 0;
  int left_right = 1;
  bool parabola = true;
  int mode = 0;
  int threads = 1;
  std::string kernel;              // empty = the best this machine runs
};

struct Image {
  const u8* data;
  int width, height;
};

// Memory of the cost volumes, kept from one call to the next.
class Workspace {
 public:
  Workspace() = default;
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;
  ~Workspace();
  void reserve(u64 costs, u64 sums);  // throws std::bad_alloc
  void release();
  u64 bytes() const { return bytes_; }
  u8* cost = nullptr;
  u8* sum = nullptr;

 private:
  void* memory_ = nullptr;
  u64 bytes_ = 0;
};

struct Ranges {                    // null first = dense
  const i16* first = nullptr;
  const u8* blocks = nullptr;
  int low = 0, count = 0;
};

// Bytes of the cost volumes that a match will need.
u64 volume_bytes(const Image& left, const Ranges& ranges, const Options& options);

// Writes (height, width) disparities, NaN = none; score may be null. Throws std::invalid_argument.
void match(const Image& left, const Image& right, const Ranges& ranges, const u8* mutual, const Options& options,
           Workspace& workspace, float* disparity, u16* score);

const Kernel& find_kernel(const std::string& name);

}  // namespace sgm
