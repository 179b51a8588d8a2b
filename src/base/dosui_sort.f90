!! Sorting and searching of 64-bit keys.
module dosui_sort
  use dosui_kinds, only: i8
  implicit none
  private

  public :: sort_permutation, unique_sorted, binary_search

  integer, parameter :: digit_bits = 11
  integer, parameter :: n_bucket = 2**digit_bits
  integer, parameter :: n_digit = 6             !! 66 bits cover a 64-bit key
  integer(i8), parameter :: sign_bit = not(huge(1_i8))
  integer, parameter :: few = 64                !! below this, insertion beats counting

contains

  subroutine sort_permutation(keys, permutation)
    !! Stable order of keys: keys(permutation(k)) does not decrease with k.
    !!
    !! Radix sort by digits of 11 bits, the lowest first; digits in which all keys agree are
    !! skipped, so that grid keys of a compact domain cost two or three passes.
    integer(i8), intent(in) :: keys(:)
    integer, allocatable, intent(out) :: permutation(:)   !! (size(keys))
    integer(i8), allocatable :: key_from(:), key_to(:)
    integer, allocatable :: order_from(:), order_to(:), count(:, :)
    integer :: n, k, digit

    n = size(keys)
    allocate (permutation(n))
    do k = 1, n
      permutation(k) = k
    end do
    if (already_sorted(keys)) return
    if (n <= few) then
      call insertion_sort(n, keys, permutation)
      return
    end if
    allocate (key_from(n), key_to(n), order_from(n), order_to(n))
    allocate (count(0:n_bucket - 1, 0:n_digit - 1))
    do k = 1, n
      key_from(k) = ieor(keys(k), sign_bit)   ! negative keys come before positive ones
      order_from(k) = k
    end do
    call count_digits(n, key_from, count)
    do digit = 0, n_digit - 1
      if (maxval(count(:, digit)) == n) cycle
      call distribute(n, digit, count(:, digit), key_from, order_from, key_to, order_to)
      call swap(key_from, key_to, order_from, order_to)
    end do
    call move_alloc(order_from, permutation)
  end subroutine sort_permutation

  pure subroutine count_digits(n, keys, count)
    !! How often each value of each digit occurs.
    integer, intent(in) :: n
    integer(i8), intent(in) :: keys(n)
    integer, intent(out) :: count(0:n_bucket - 1, 0:n_digit - 1)
    integer :: k, digit, bucket

    count = 0
    do k = 1, n
      do digit = 0, n_digit - 1
        bucket = digit_of(keys(k), digit)
        count(bucket, digit) = count(bucket, digit) + 1
      end do
    end do
  end subroutine count_digits

  pure subroutine distribute(n, digit, count, key_from, order_from, key_to, order_to)
    !! One stable pass: entries ordered by one digit.
    integer, intent(in) :: n, digit
    integer, intent(in) :: count(0:n_bucket - 1)
    integer(i8), intent(in) :: key_from(n)
    integer, intent(in) :: order_from(n)
    integer(i8), intent(out) :: key_to(n)
    integer, intent(out) :: order_to(n)
    integer :: next(0:n_bucket - 1)
    integer :: k, bucket, place

    next(0) = 1
    do bucket = 1, n_bucket - 1
      next(bucket) = next(bucket - 1) + count(bucket - 1)
    end do
    do k = 1, n
      bucket = digit_of(key_from(k), digit)
      place = next(bucket)
      next(bucket) = place + 1
      key_to(place) = key_from(k)
      order_to(place) = order_from(k)
    end do
  end subroutine distribute

  pure subroutine swap(key_a, key_b, order_a, order_b)
    !! Exchanges two buffers without copying them.
    integer(i8), allocatable, intent(inout) :: key_a(:), key_b(:)
    integer, allocatable, intent(inout) :: order_a(:), order_b(:)
    integer(i8), allocatable :: key(:)
    integer, allocatable :: order(:)

    call move_alloc(key_a, key)
    call move_alloc(key_b, key_a)
    call move_alloc(key, key_b)
    call move_alloc(order_a, order)
    call move_alloc(order_b, order_a)
    call move_alloc(order, order_b)
  end subroutine swap

  pure subroutine insertion_sort(n, keys, permutation)
    !! Stable order of a few keys.
    integer, intent(in) :: n
    integer(i8), intent(in) :: keys(:)
    integer, intent(inout) :: permutation(:)     !! 1, 2, ..., n on entry
    integer :: k, j

    do k = 2, n
      j = k - 1
      do while (j >= 1)
        if (keys(permutation(j)) <= keys(k)) exit
        permutation(j + 1) = permutation(j)
        j = j - 1
      end do
      permutation(j + 1) = k
    end do
  end subroutine insertion_sort

  pure logical function already_sorted(keys) result(sorted)
    !! Are the keys in order already?
    integer(i8), intent(in) :: keys(:)
    integer :: k

    sorted = .true.
    do k = 2, size(keys)
      if (keys(k) < keys(k - 1)) then
        sorted = .false.
        return
      end if
    end do
  end function already_sorted

  pure integer function digit_of(key, digit) result(bucket)
    !! A digit of a key.
    integer(i8), intent(in) :: key
    integer, intent(in) :: digit

    bucket = int(iand(ishft(key, -digit_bits*digit), int(n_bucket - 1, i8)))
  end function digit_of

  pure function unique_sorted(keys) result(unique)
    !! The distinct values of sorted keys, sorted.
    integer(i8), intent(in) :: keys(:)
    integer(i8), allocatable :: unique(:)
    integer :: k, n

    n = min(1, size(keys))
    do k = 2, size(keys)
      if (keys(k) /= keys(k - 1)) n = n + 1
    end do
    allocate (unique(n))
    if (n == 0) return
    n = 1
    unique(1) = keys(1)
    do k = 2, size(keys)
      if (keys(k) == unique(n)) cycle
      n = n + 1
      unique(n) = keys(k)
    end do
  end function unique_sorted

  pure integer function binary_search(keys, key) result(position)
    !! Where a key stands in sorted keys; 0 when it is absent.
    integer(i8), intent(in) :: keys(:)
    integer(i8), intent(in) :: key
    integer :: low, high, middle

    low = 1
    high = size(keys)
    position = 0
    do while (low <= high)
      middle = low + (high - low)/2
      if (keys(middle) == key) then
        position = middle
        return
      else if (keys(middle) < key) then
        low = middle + 1
      else
        high = middle - 1
      end if
    end do
  end function binary_search
end module dosui_sort
