#include "sim/files/key_table.hpp"

namespace taut {

KeyTable*& KeyNotes::current() {
  thread_local KeyTable* root = nullptr;
  return root;
}

}  // namespace taut
