#include "experiments/cli/mpi.hpp"

#include <cstdlib>

#include "sim/core/error.hpp"

#ifdef TAUT_MPI
#include <mpi.h>

#include <algorithm>
#include <chrono>
#include <iostream>
#include <list>
#include <memory>
#include <mutex>
#include <thread>
#endif

namespace taut {
namespace {

/// How many processes the launcher says it started: what Open MPI, and MPICH with its kin, tell each of them.
int started_together() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"}) {
    if (const char* size = std::getenv(name)) return std::atoi(size);
  }
  return 1;
}

#ifdef TAUT_MPI

/// Text over MPI, by polling: a process that waits must not keep a core busy that another one works on.
class MpiMessages final : public Messages {
 public:
  MpiMessages() {
    int provided = 0;
    MPI_Init_thread(nullptr, nullptr, MPI_THREAD_SERIALIZED, &provided);
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);  // a dead receiver is found by its silence
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &size_);
    if (provided < MPI_THREAD_SERIALIZED)
      throw InputError("this MPI serves one thread only, and taut needs two; use another one, or --shard");
    if (const char* seconds = std::getenv("TAUT_MPI_SILENCE")) silence_ = std::max(0.1, std::atof(seconds));
  }

  int rank() const override { return rank_; }
  int size() const override { return size_; }
  double silence() const override { return silence_; }

  void send(int to, const std::string& text) override {
    const std::lock_guard lock(mutex_);
    forget_sent();
    Sent& sent = sent_.emplace_back(Sent{text, MPI_REQUEST_NULL});
    MPI_Isend(sent.text.data(), static_cast<int>(sent.text.size()), MPI_CHAR, to, 0, MPI_COMM_WORLD, &sent.request);
  }

  std::optional<Message> receive(double seconds) override {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    auto pause = std::chrono::microseconds(20);
    while (true) {
      if (std::optional<Message> message = arrived()) return message;
      if (std::chrono::steady_clock::now() > end) return std::nullopt;
      std::this_thread::sleep_for(pause);
      pause = std::min(2 * pause, std::chrono::microseconds(2000));
    }
  }

  /// Whether all that was sent has gone.
  bool all_sent() {
    const std::lock_guard lock(mutex_);
    forget_sent();
    return sent_.empty();
  }

 private:
  struct Sent {
    std::string text;
    MPI_Request request;
  };

  std::optional<Message> arrived() {
    const std::lock_guard lock(mutex_);
    int there = 0, length = 0;
    MPI_Status status;
    if (MPI_Iprobe(MPI_ANY_SOURCE, 0, MPI_COMM_WORLD, &there, &status) != MPI_SUCCESS || there == 0)
      return std::nullopt;
    MPI_Get_count(&status, MPI_CHAR, &length);
    Message message{status.MPI_SOURCE, std::string(static_cast<size_t>(length), '\0')};
    MPI_Recv(message.text.data(), length, MPI_CHAR, status.MPI_SOURCE, 0, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
    return message;
  }

  void forget_sent() {
    std::erase_if(sent_, [](Sent& sent) {
      int gone = 0;
      return MPI_Test(&sent.request, &gone, MPI_STATUS_IGNORE) == MPI_SUCCESS && gone != 0;
    });
  }

  std::mutex mutex_;
  std::list<Sent> sent_;  ///< MPI reads the texts until their requests are done
  int rank_ = 0, size_ = 1;
  double silence_ = 60;
};

std::unique_ptr<MpiMessages> joined;

#endif

}  // namespace

#ifdef TAUT_MPI

Messages* mpi_messages() {
  if (!joined && started_together() > 1) joined = std::make_unique<MpiMessages>();
  return joined.get();
}

int leave_mpi(int code) {
  if (!joined) return code;
  if (joined->rank() == 0) {
    for (int rank = 1; rank < joined->size(); ++rank) joined->send(rank, "over");
  }
  for (int i = 0; i < 100 && !joined->all_sent(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  // MPI_Finalize waits for all, also for one on a machine that can no longer be reached. Rank 0, the last to be done,
  // has written everything by now and leaves without it; the others wait for rank 0, which may sum up for long.
  if (joined->rank() == 0)
    std::thread([code, patience = joined->silence()] {
      std::this_thread::sleep_for(std::chrono::duration<double>(patience));
      std::cerr << "taut: some process of this job can no longer be reached; this one ends without it\n";
      std::_Exit(code);
    }).detach();
  MPI_Finalize();
  return code;
}

#else

Messages* mpi_messages() {
  if (started_together() > 1)
    throw InputError(
        "mpirun has started several processes, and this taut was built without MPI: each would do the whole work; "
        "build "
        "it with -DTAUT_MPI=ON, or start one process per part with --shard 1/N, 2/N, ...");
  return nullptr;
}

int leave_mpi(int code) {
  return code;
}

#endif

}  // namespace taut
