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
  for (int row = w.thread; row < w.job->height; row += w.threads) {
    if (w.job->ragged) ragged_row<DIR>(w, row);
    else dense_row<DIR>(w, row);
  }
}

}  // namespace SGM_ISA
}  // namespace sgm
