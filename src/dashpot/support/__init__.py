"""What every room uses: tables of files, folders, reports, pictures, processes."""
