// A thin owner of SQLite handles: statements that bind and read C++ values and throw on every error.
#pragma once

#include <sqlite3.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>

#include "iris/core/error.h"

namespace iris::workspace {

class Database {
 public:
  enum class Access { read_write, read_only };

  Database(const std::filesystem::path& path, Access access) : path_(path) {
    int flags = access == Access::read_only ? SQLITE_OPEN_READONLY : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
    std::string name = path.string();
    // Even for reading SQLite makes files beside a WAL database, unless it is told that nobody writes: the case where
    // the folder is not ours to write and no run has left its log there.
    const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
    if (access == Access::read_only && ::access(folder.c_str(), W_OK) != 0 && !std::filesystem::exists(name + "-wal")) {
      name = "file:" + uri_text(name) + "?immutable=1";
      flags |= SQLITE_OPEN_URI;
    }
    if (sqlite3_open_v2(name.c_str(), &handle_, flags | SQLITE_OPEN_FULLMUTEX, nullptr) != SQLITE_OK) {
      const std::string message = sqlite3_errmsg(handle_);
      sqlite3_close(handle_);
      throw InputError(path, "cannot be opened (" + message + ")", "check the folder and its permissions");
    }
    sqlite3_busy_timeout(handle_, 10000);
  }
  ~Database() { sqlite3_close(handle_); }
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;

  sqlite3* handle() const { return handle_; }

  void run(const char* sql) const {
    if (sqlite3_exec(handle_, sql, nullptr, nullptr, nullptr) != SQLITE_OK) fail();
  }

  [[noreturn]] void fail() const {
    const int code = sqlite3_errcode(handle_);
    const std::string message = sqlite3_errmsg(handle_);
    const char* remedy = "check the folder and its permissions, or choose another with -o";
    if (code == SQLITE_FULL || code == SQLITE_IOERR) {
      remedy =
          "see that the disk is sound and has free space, then run the same command again: it goes on where it stopped";
    }
    if (code == SQLITE_NOTADB || code == SQLITE_CORRUPT)
      remedy = "it is damaged; delete the output folder and run again";
    throw InputError(path_, message, remedy);
  }

 private:
  // With what has a meaning in URIs written as %XX.
  static std::string uri_text(const std::string& path) {
    std::string text;
    for (const char c : path) {
      constexpr char kDigits[] = "0123456789abcdef";
      if (c != '%' && c != '?' && c != '#') {
        text += c;
      } else {
        text += {'%', kDigits[c >> 4], kDigits[c & 15]};
      }
    }
    return text;
  }

  std::filesystem::path path_;
  sqlite3* handle_ = nullptr;
};

class Statement {
 public:
  Statement(const Database& database, std::string_view sql) : database_(database) {
    if (sqlite3_prepare_v2(database.handle(), sql.data(), static_cast<int>(sql.size()), &handle_, nullptr) !=
        SQLITE_OK) {
      database.fail();
    }
  }
  ~Statement() { sqlite3_finalize(handle_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  // Binds the arguments to ?1, ?2, … in order.
  template <class... Arguments>
  Statement& bind(const Arguments&... arguments) {
    int at = 0;
    (bind_one(++at, arguments), ...);
    return *this;
  }

  // The next row; false after the last.
  bool step() {
    const int result = sqlite3_step(handle_);
    if (result != SQLITE_ROW && result != SQLITE_DONE) database_.fail();
    return result == SQLITE_ROW;
  }

  int64_t integer(int column) const { return sqlite3_column_int64(handle_, column); }
  double real(int column) const { return sqlite3_column_double(handle_, column); }
  std::string text(int column) const {
    const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(handle_, column));
    return text ? std::string(text, static_cast<size_t>(sqlite3_column_bytes(handle_, column))) : std::string();
  }
  // Doubles are kept as they are in memory, bit for bit.
  template <class Matrix>
  Matrix matrix(int column) const {
    Matrix m;
    if (static_cast<size_t>(sqlite3_column_bytes(handle_, column)) != sizeof(double) * static_cast<size_t>(m.size())) {
      throw Bug("a record of the workspace has another size than this version writes");
    }
    std::memcpy(m.data(), sqlite3_column_blob(handle_, column), sizeof(double) * static_cast<size_t>(m.size()));
    return m;
  }

 private:
  void bind_one(int at, int value) { check(sqlite3_bind_int(handle_, at, value)); }
  void bind_one(int at, int64_t value) { check(sqlite3_bind_int64(handle_, at, value)); }
  void bind_one(int at, bool value) { check(sqlite3_bind_int(handle_, at, value)); }
  void bind_one(int at, double value) { check(sqlite3_bind_double(handle_, at, value)); }
  void bind_one(int at, const std::string& value) {
    check(sqlite3_bind_text(handle_, at, value.data(), static_cast<int>(value.size()), SQLITE_TRANSIENT));
  }
  template <class Matrix>
  requires requires(const Matrix& m) {
    m.data();
    m.rows();
  }
  void bind_one(int at, const Matrix& m) {
    check(sqlite3_bind_blob(handle_, at, m.data(), static_cast<int>(sizeof(double) * static_cast<size_t>(m.size())),
                            SQLITE_TRANSIENT));
  }
  void check(int result) const {
    if (result != SQLITE_OK) database_.fail();
  }

  const Database& database_;
  sqlite3_stmt* handle_ = nullptr;
};

// All or nothing: rolled back unless committed.
class Transaction {
 public:
  explicit Transaction(const Database& database) : database_(database) { database_.run("BEGIN IMMEDIATE"); }
  ~Transaction() {
    if (!committed_) sqlite3_exec(database_.handle(), "ROLLBACK", nullptr, nullptr, nullptr);
  }
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;
  void commit() {
    database_.run("COMMIT");
    committed_ = true;
  }

 private:
  const Database& database_;
  bool committed_ = false;
};

}  // namespace iris::workspace
