#!/bin/sh
# Make a certificate authority and certificates for router.json5 in ./certificates, which must not exist yet:
#
#     sh certificates.sh fleet.local 127.0.0.1
#
# The arguments are the names and addresses of the router. openssl is required. Anyone who has ca.key can make further
# certificates, so do not keep it on the router. The certificates are valid for a year.
set -eu
mkdir certificates
cd certificates
umask 077
names=DNS:localhost
for each in "$@"; do
  case $each in
    *[!0-9.]*) names=$names,DNS:$each ;;
    *) names=$names,IP:$each ;;
  esac
done
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 365 -subj /CN=urlink-ca \
  -addext basicConstraints=critical,CA:TRUE -addext keyUsage=critical,keyCertSign -keyout ca.key -out ca.pem
for name in router server operator reader; do
  alternative=DNS:$name
  [ $name = router ] && alternative=$names
  openssl req -new -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "/CN=$name" \
    -keyout $name.key -out $name.csr
  printf 'subjectAltName=%s\nbasicConstraints=CA:FALSE\nextendedKeyUsage=serverAuth,clientAuth\n' "$alternative" >$name.ext
  openssl x509 -req -in $name.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 365 -extfile $name.ext -out $name.pem
  rm $name.csr $name.ext
done
