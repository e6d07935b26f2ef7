"""What travels inside an FMU beside the code: pages, figures, reference results, licences."""
