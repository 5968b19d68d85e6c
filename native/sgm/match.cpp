#include "match.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <stdexcept>
#include <thread>
#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace sgm {

namespace {

constexpr u64 kPage = 2u << 20;
constexpr int kMaxDisparity = 30000;
constexpr int kFirstLevel = 16 << 10;  // bytes of the first-level cache that a thread may fill
constexpr int kLinesInWork = 22;       // bytes for each disparity of a row in work: path costs, census, sums
constexpr u64 kStreamed = 16u << 20;   // bytes of sums from which on they bypass the caches

// Bytes handed out one after the other, each aligned to 64.
class Arena {
 public:
  template <class T>
  T* take(u64 count, u8 fill = 0) {
    parts_.emplace_back(new u8[count * sizeof(T) + kSlack + 64]);
    u8* p = parts_.back().get();
    std::memset(p, fill, count * sizeof(T) + kSlack + 64);
    return reinterpret_cast<T*>((reinterpret_cast<std::uintptr_t>(p) + 63) & ~std::uintptr_t{63});
  }

 private:
  std::vector<std::unique_ptr<u8[]>> parts_;
};

void require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

void check(const Image& left, const Image& right, const Ranges& r, const u8* mutual, const Options& o) {
  require(left.width > 0 && left.height > 0 && right.width > 0, "images must have at least one pixel");
  require(left.height == right.height, "left and right image must have the same height");
  require(left.width < kMaxDisparity && right.width < kMaxDisparity, "images wider than 29999 pixels: cut them");
  require(o.radius_x >= 1 && o.radius_y >= 1 && (2 * o.radius_x + 1) * (2 * o.radius_y + 1) <= 65,
          "the census window has 3 x 3 to 65 pixels");
  require(o.small >= 0 && o.small <= o.large && o.large <= 127, "0 <= P1 <= P2 <= 127");
  require(o.large_by_step.empty() || o.large_by_step.size() == 16, "the adaptive P2 has 16 entries");
  for (int p : o.large_by_step) require(p >= 1 && p <= o.large, "adaptive P2 lies between 1 and P2");
  require(o.uniqueness >= 0 && o.uniqueness < 100, "uniqueness is a percentage below 100");
  require(o.mode >= 0 && o.mode <= 2, "cost mode is 0, 1 or 2");
  require(o.mode == 0 || mutual, "mutual information needs its table");
  require(o.threads >= 1 && o.threads <= 1024, "1 to 1024 threads");
  if (r.first) {
    const u64 n = static_cast<u64>(left.width) * left.height;
    for (u64 i = 0; i < n; ++i) {
      require(r.blocks[i] > 0, "every pixel needs at least one block of disparities");
      require(std::abs(r.first[i]) <= kMaxDisparity, "disparities must lie within +-30000");
    }
  } else {
    require(r.count > 0 && r.count <= 32768, "1 to 32768 disparities");
    require(std::abs(r.low) <= kMaxDisparity && r.low + r.count <= kMaxDisparity, "disparities must lie within +-30000");
  }
}

int padded_count(const Ranges& r, const Kernel& kernel) {
  return (r.count + kernel.lanes - 1) / kernel.lanes * kernel.lanes;
}

// Edge pixels repeated on all sides; mirrored if asked. Returns pixel (0, 0).
u8* padded_image(Arena& arena, const Image& image, int above, bool mirror, std::ptrdiff_t* stride) {
  *stride = image.width + 2 * kMargin + kMargin;
  u8* all = arena.take<u8>(static_cast<u64>(*stride) * (image.height + 2 * above));
  for (int y = -above; y < image.height + above; ++y) {
    const u8* from = image.data + static_cast<u64>(std::min(std::max(y, 0), image.height - 1)) * image.width;
    u8* to = all + (y + above) * *stride;
    u8* row = to + kMargin;
    if (mirror) std::reverse_copy(from, from + image.width, row);
    else std::copy(from, from + image.width, row);
    std::fill(to, row, row[0]);
    std::fill(row + image.width, to + *stride, row[image.width - 1]);
  }
  return all + above * *stride + kMargin;
}

std::vector<u64> row_offsets(const Job& job) {
  std::vector<u64> at(job.height + 1, 0);
  for (int y = 0; y < job.height; ++y) {
    u64 n = static_cast<u64>(job.width) * job.padded;
    if (job.ragged) {
      n = 0;
      const u8* blocks = job.blocks + static_cast<u64>(y) * job.width;
      for (int x = 0; x < job.width; ++x) n += blocks[x];
      n *= kBlock;
    }
    at[y + 1] = at[y] + n;
  }
  return at;
}

Job make_job(Arena& arena, const Image& left, const Image& right, const Ranges& r, const Options& o,
             const Kernel& kernel) {
  Job job{};
  job.width = left.width;
  job.height = left.height;
  job.right_width = right.width;
  job.radius_x = o.radius_x;
  job.radius_y = o.radius_y;
  job.left = padded_image(arena, left, o.radius_y, false, &job.left_stride);
  job.right = padded_image(arena, right, o.radius_y, true, &job.right_stride);
  job.ragged = r.first != nullptr;
  job.first = r.first;
  job.blocks = r.blocks;
  job.low = r.low;
  job.count = r.count;
  job.padded = padded_count(r, kernel);
  job.small = static_cast<u8>(o.small);
  job.large = static_cast<u8>(o.large);
  for (int i = 0; i < 16; ++i) {
    job.large_by_step[i] = static_cast<u8>(o.large_by_step.empty() ? o.large : o.large_by_step[i]);
  }
  // Two thirds of the bits: more than two unrelated windows differ in, so that what can be seen is preferred.
  job.outside = static_cast<u8>(((2 * o.radius_x + 1) * (2 * o.radius_y + 1) - 1) * 2 / 3);
  job.mode = static_cast<CostMode>(o.mode);
  job.uniqueness = o.uniqueness;
  job.left_right = o.left_right;
  job.parabola = o.parabola;
  return job;
}

// Memory for path costs of `pixels` pixels; ragged: of `longest` cells in all.
Row make_row(Arena& arena, const Job& job, int pixels, u64 longest, int lanes) {
  Row row{};
  const u64 dense = static_cast<u64>(pixels + 1) * (job.padded + lanes);
  const u64 ragged = longest + static_cast<u64>(pixels + 2) * kBlock;
  for (auto& path : row.path) path = arena.take<u8>(job.ragged ? ragged : dense, kFar);
  row.least = arena.take<u8>(job.ragged ? 1 : 4 * static_cast<u64>(pixels));
  row.at = arena.take<u32>(job.ragged ? pixels : 1);
  return row;
}

Scratch make_scratch(Arena& arena, const Job& job, int most, int lanes) {
  Scratch s{};
  const int widest = std::max(job.width, job.right_width);
  s.plane_stride = (widest + 2 * kMargin + 63) / 64 * 64;
  s.left_planes = arena.take<u8>(8 * s.plane_stride) + kMargin;
  s.right_planes = arena.take<u8>(8 * s.plane_stride) + kMargin;
  if (job.ragged) {
    s.left_census = arena.take<u64>(job.width + 64);
    s.right_census = arena.take<u64>(job.right_width + 2 * kBlock + 64) + kBlock;
  } else {
    s.near = make_row(arena, job, kSlots, 0, lanes);
  }
  s.cost = arena.take<u8>(most);
  for (auto& p : s.penalty) p = arena.take<u8>(job.width + kMargin);
  for (auto& p : s.from) p = arena.take<u32>(job.width);
  for (auto& p : s.lines) p = arena.take<u8>(most + 2 * kMargin, kFar) + kMargin;
  for (auto& p : s.beside) p = arena.take<u8>(most + 2 * kMargin, kFar) + kMargin;
  s.zero = arena.take<u8>(most + 2 * kMargin) + kMargin;
  s.total = arena.take<u16>(most + 2 * kMargin) + kBlock;
  s.best = arena.take<i16>(job.width);
  for (auto& p : s.around) p = arena.take<u16>(job.width);
  s.right_best = arena.take<u32>(job.right_width);
  return s;
}

struct Extent {
  int most = 0;       // disparities of the pixel that has most
  u64 longest = 0;    // cells of the longest row
  int lowest = 0;
};

// Rows matched together in the dense form, at least two: what they have in work fits the first-level cache.
int band_rows(const Job& job, int lanes) {
  return std::min(std::max(kFirstLevel / (kLinesInWork * (job.padded + lanes)), 2), 8);
}

Extent extent_of(const Job& job, const std::vector<u64>& at) {
  Extent e{job.padded, 0, job.low};
  for (int y = 0; y < job.height; ++y) e.longest = std::max(e.longest, at[y + 1] - at[y]);
  if (job.ragged) {
    const u64 n = static_cast<u64>(job.width) * job.height;
    e.most = kBlock * *std::max_element(job.blocks, job.blocks + n);
    e.lowest = *std::min_element(job.first, job.first + n);
  }
  return e;
}

}  // namespace

Workspace::~Workspace() { release(); }

void Workspace::release() {
  std::free(memory_);
  memory_ = nullptr;
  bytes_ = 0;
  cost = nullptr;
  sum = nullptr;
}

void Workspace::reserve(u64 costs, u64 sums) {
  const u64 before = (costs + kSlack + 63) / 64 * 64, needed = before + sums + kSlack;
  if (needed > bytes_) {
    release();
    const u64 rounded = (needed + needed / 16 + kPage - 1) / kPage * kPage;
    void* p = nullptr;
    if (posix_memalign(&p, kPage, rounded) != 0) throw std::bad_alloc();
#if defined(__linux__)
    madvise(p, rounded, MADV_HUGEPAGE);  // small pages would cost more to fetch than the matching itself
#endif
    memory_ = p;
    bytes_ = rounded;
  }
  cost = static_cast<u8*>(memory_);
  sum = cost + before;
}

const Kernel& find_kernel(const std::string& name) {
  int n = 0;
  const Kernel* list = kernels(&n);
  if (name.empty()) return list[0];
  for (int i = 0; i < n; ++i) {
    if (name == list[i].name) return list[i];
  }
  throw std::invalid_argument("this machine cannot run the kernel " + name);
}

namespace {

// The best kernel, or the next one where its wider vectors would stay empty by more than a quarter of the range.
const Kernel& choose_kernel(const Ranges& r, const Options& o) {
  const Kernel& best = find_kernel(o.kernel);
  int n = 0;
  const Kernel* list = kernels(&n);
  if (!o.kernel.empty() || r.first || n < 2 || r.count < 1) return best;
  return 4 * padded_count(r, best) > 5 * padded_count(r, list[1]) ? list[1] : best;
}

}  // namespace

u64 volume_bytes(const Image& left, const Ranges& ranges, const Options& options) {
  const u64 pixels = static_cast<u64>(left.width) * left.height;
  u64 cells = pixels * static_cast<u64>(padded_count(ranges, choose_kernel(ranges, options)));
  if (ranges.blocks) {
    cells = 0;
    for (u64 i = 0; i < pixels; ++i) cells += ranges.blocks[i];
    cells *= kBlock;
  }
  return ranges.blocks ? 2 * cells : cells;  // the dense form makes its costs anew
}

void match(const Image& left, const Image& right, const Ranges& ranges, const u8* mutual, const Options& options,
           Workspace& workspace, float* disparity, u16* score) {
  check(left, right, ranges, mutual, options);
  const Kernel& kernel = choose_kernel(ranges, options);
  Arena arena;
  Job job = make_job(arena, left, right, ranges, options, kernel);
  const std::vector<u64> at = row_offsets(job);
  job.row_offset = at.data();
  job.mutual = mutual;
  job.disparity = disparity;
  job.score = score;
  workspace.reserve(job.ragged ? at.back() : 0, at.back());
  job.cost = workspace.cost;
  job.sum = workspace.sum;
  job.streamed = !job.ragged && at.back() >= kStreamed;
  const Extent extent = extent_of(job, at);
  const int bands = job.ragged ? job.height : std::max(1, job.height / band_rows(job, kernel.lanes));
  const int threads = std::min(options.threads, bands), rows = (job.height + bands - 1) / bands;
  std::vector<Row> ring;
  for (int i = 0; i < (job.ragged ? threads + 1 : 1); ++i) {
    ring.push_back(make_row(arena, job, job.width, extent.longest, kernel.lanes));
  }
  std::vector<Scratch> scratch;
  for (int i = 0; i < threads * rows; ++i) scratch.push_back(make_scratch(arena, job, extent.most, kernel.lanes));
  std::unique_ptr<std::atomic<int>[]> done(new std::atomic<int>[job.height]);
  for (auto sweep : {kernel.forward, kernel.backward}) {
    for (int y = 0; y < job.height; ++y) done[y].store(0);
    const auto work = [&](int t) {
      sweep(Sweep{&job, t, threads, ring.data(), bands, &scratch[t * rows], done.get(), extent.lowest,
                  [] { std::this_thread::yield(); }});
    };
    std::vector<std::thread> others;
    for (int t = 1; t < threads; ++t) others.emplace_back(work, t);
    work(0);
    for (auto& thread : others) thread.join();
  }
}

}  // namespace sgm
