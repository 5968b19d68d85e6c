// One instruction set's kernel: the file that includes this names it (SGM_ISA) and its vectors before.
#include "types.h"

namespace sgm {
namespace SGM_ISA {

static inline void relax() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  __asm__ __volatile__("yield");
#endif
}

#include "rows.inl"
#include "dense.inl"
#include "ragged.inl"

template <int DIR>
static void sweep(const Sweep& w) {
  for (int row = w.thread; w.job->ragged && row < w.job->height; row += w.threads) ragged_row<DIR>(w, row);
  for (int band = w.thread; !w.job->ragged && band < w.bands; band += w.threads) dense_band<DIR>(w, band);
  if (DIR > 0 && w.job->streamed) stream_end();
}

}  // namespace SGM_ISA
}  // namespace sgm
